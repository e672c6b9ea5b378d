-- table: defects
-- grain: defect
-- meaning: a defect's sightings are the photographs of its observations, at least one
SELECT d.defect_id, d.sightings, count(DISTINCT o.photo_id) AS photographs
FROM defects AS d
LEFT JOIN observations AS o USING (defect_id)
GROUP BY d.defect_id, d.sightings
HAVING count(DISTINCT o.photo_id) <> d.sightings OR d.sightings < 1
