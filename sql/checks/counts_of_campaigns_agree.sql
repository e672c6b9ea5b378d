-- table: campaigns
-- grain: count that differs
-- meaning: the campaign's counts are those of its tables
SELECT counted.what, counted.stated, counted.found
FROM (
    SELECT 'photos_total' AS what, photos_total AS stated, (SELECT count(*) FROM photos) AS found FROM campaigns
    UNION ALL
    SELECT 'photos_localised', photos_localised, (
        SELECT count(*) FROM poses WHERE pose_source IN ('sfm', 'resected', 'imported')
    )
    FROM campaigns
    UNION ALL
    SELECT 'detections_total', detections_total, (SELECT count(*) FROM detections) FROM campaigns
    UNION ALL
    SELECT 'defects_total', defects_total, (SELECT count(*) FROM defects) FROM campaigns
) AS counted
WHERE counted.stated <> counted.found
