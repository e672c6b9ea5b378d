-- table: observations
-- grain: detection
-- meaning: accepted detections and observations are the same set, in the same photographs and classes
SELECT coalesce(d.detection_id, o.detection_id) AS detection_id, d.photo_id, o.photo_id AS observed_in,
       d.defect_class, o.defect_class AS observed_class
FROM (SELECT * FROM detections WHERE detection_outcome = 'accepted') AS d
FULL JOIN observations AS o ON o.detection_id = d.detection_id
WHERE d.detection_id IS NULL OR o.detection_id IS NULL
   OR d.photo_id <> o.photo_id OR d.defect_class <> o.defect_class
