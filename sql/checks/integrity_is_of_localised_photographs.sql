-- table: integrity_views
-- grain: view
-- meaning: integrity was looked at in localised photographs alone, and a compared view has its figures
SELECT i.photo_id, i.integrity_outcome, i.ssim, p.pose_source
FROM integrity_views AS i
LEFT JOIN poses AS p USING (photo_id)
WHERE coalesce(p.pose_source, 'unlocalised') IN ('unlocalised', 'prior')
   OR (i.integrity_outcome = 'compared' AND i.ssim IS NULL)
   OR (i.integrity_outcome <> 'compared' AND coalesce(i.reason, '') = '')
