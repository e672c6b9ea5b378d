-- table: integrity_views
-- grain: view
-- meaning: only localised photographs have integrity rows, a compared view has its SSIM, any other a reason
SELECT i.photo_id, i.integrity_outcome, i.ssim, p.pose_source
FROM integrity_views AS i
LEFT JOIN poses AS p USING (photo_id)
WHERE coalesce(p.pose_source, 'unlocalised') IN ('unlocalised', 'prior')
   OR (i.integrity_outcome = 'compared' AND i.ssim IS NULL)
   OR (i.integrity_outcome <> 'compared' AND coalesce(i.reason, '') = '')
