-- table: defects
-- grain: defect
-- meaning: a defect's photo_count is the number of photographs with its observations, at least one
SELECT d.defect_id, d.photo_count, count(DISTINCT o.photo_id) AS photographs
FROM defects AS d
LEFT JOIN observations AS o USING (defect_id)
GROUP BY d.defect_id, d.photo_count
HAVING count(DISTINCT o.photo_id) <> d.photo_count OR d.photo_count < 1
