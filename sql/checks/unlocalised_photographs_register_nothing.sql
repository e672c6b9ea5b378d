-- table: observations
-- grain: observation
-- meaning: an observation is unlocalised if and only if its photograph has no measured pose
SELECT o.detection_id, o.photo_id, o.observation_outcome, p.pose_source
FROM observations AS o
LEFT JOIN poses AS p USING (photo_id)
WHERE (o.observation_outcome = 'unlocalised') <> (coalesce(p.pose_source, 'unlocalised') IN ('unlocalised', 'prior'))
