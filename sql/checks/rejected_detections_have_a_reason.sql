-- table: detections
-- grain: detection
-- meaning: a detection that is not accepted has a reason, an accepted one has a class
SELECT detection_id, detection_outcome, reason, defect_class
FROM detections
WHERE CASE WHEN detection_outcome = 'accepted' THEN defect_class IS NULL ELSE coalesce(reason, '') = '' END
