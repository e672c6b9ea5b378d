-- grain: pair of observations
-- meaning: why the observations of a defect were merged, and why neighbouring ones were not: distance, overlap, appearance
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
-- $defect_id [defects.defect_id or number]: the defect's id, or its number on the elevations; left out, all of them
SELECT
    m.building_id,
    m.campaign_id,
    m.defect_id,
    m.other_defect_id,
    m.merge_decision,
    m.merge_reason,
    round(m.separation_m, 3) AS separation_m,
    round(m.mahalanobis_distance, 2) AS mahalanobis_distance,
    round(m.overlap_share, 2) AS overlap_share,
    round(m.appearance_score, 2) AS appearance_score,
    a.photo_id,
    b.photo_id AS other_photo_id,
    a.defect_class,
    b.defect_class AS other_class,
    m.detection_id,
    m.other_detection_id
FROM merges AS m
JOIN observations AS a
    ON a.building_id = m.building_id AND a.campaign_id = m.campaign_id AND a.detection_id = m.detection_id
JOIN observations AS b
    ON b.building_id = m.building_id AND b.campaign_id = m.campaign_id AND b.detection_id = m.other_detection_id
WHERE ($building_id::VARCHAR IS NULL OR m.building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR m.campaign_id = $campaign_id)
  AND (
      $defect_id::VARCHAR IS NULL
      OR $defect_id IN (m.defect_id, m.other_defect_id)
      OR ltrim($defect_id, '0') IN (
          ltrim(regexp_extract(m.defect_id, '[0-9]+$'), '0'),
          ltrim(regexp_extract(m.other_defect_id, '[0-9]+$'), '0')
      )
  )
ORDER BY m.building_id, m.campaign_id, m.defect_id, m.merge_decision DESC, m.mahalanobis_distance, m.detection_id
