-- table: poses
-- grain: photograph
-- meaning: accepted photographs and rows of poses are the same set
SELECT coalesce(p.photo_id, q.photo_id) AS photo_id, p.photo_id IS NULL AS pose_without_photograph
FROM (SELECT photo_id FROM photos WHERE photo_outcome = 'accepted') AS p
FULL JOIN poses AS q ON q.photo_id = p.photo_id
WHERE p.photo_id IS NULL OR q.photo_id IS NULL
