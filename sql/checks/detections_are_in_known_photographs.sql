-- table: detections
-- grain: detection
-- meaning: an accepted detection is in an accepted photograph
SELECT d.detection_id, d.photo_id, p.photo_outcome
FROM detections AS d
LEFT JOIN photos AS p USING (photo_id)
WHERE d.detection_outcome = 'accepted' AND coalesce(p.photo_outcome, 'unknown') <> 'accepted'
