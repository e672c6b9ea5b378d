-- grain: detection
-- meaning: what became of each detection in the end, with the stage that decided it and the words it gave
SELECT
    d.building_id,
    d.campaign_id,
    d.detection_id,
    d.photo_id,
    d.defect_class,
    d.source_class,
    d.score,
    CASE WHEN d.detection_outcome = 'accepted' THEN 'register' ELSE 'detect' END AS stage,
    CASE WHEN d.detection_outcome = 'accepted' THEN o.observation_outcome ELSE d.detection_outcome END AS outcome,
    d.reason,
    o.defect_id
FROM detections AS d
LEFT JOIN observations AS o USING (building_id, campaign_id, detection_id)
