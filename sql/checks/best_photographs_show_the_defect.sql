-- table: defects
-- grain: defect
-- meaning: a defect's best photograph is one of its observations'
SELECT d.defect_id, d.best_photo_id
FROM defects AS d
WHERE NOT EXISTS (SELECT 1 FROM observations AS o WHERE o.defect_id = d.defect_id AND o.photo_id = d.best_photo_id)
