-- table: detections
-- grain: detection
-- meaning: a detection's photograph is in photos, unless its outcome says otherwise
SELECT d.detection_id, d.photo_id, d.detection_outcome
FROM detections AS d
LEFT JOIN photos AS p USING (photo_id)
WHERE (p.photo_id IS NULL) <> (d.detection_outcome = 'unknown_photo')
