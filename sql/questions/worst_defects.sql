-- grain: defect
-- meaning: the defects to look at first: by severity, then by their largest extent
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
-- $limit [number]: rows at most; left out, 20
SELECT
    building_id,
    campaign_id,
    defect_id,
    track_id,
    track_state,
    defect_class,
    severity,
    severity_low,
    severity_high,
    severity_rule,
    graded_by,
    round(greatest(width_m, height_m), 3) AS extent_m,
    round(area_m2, 4) AS area_m2,
    crack_width_mm,
    crack_width_sigma_mm,
    photo_count,
    score,
    ifc_class,
    element_name,
    storey,
    facade,
    lon_deg,
    lat_deg,
    height_ellipsoidal_m,
    captured_to,
    best_photo_id,
    best_photo_uri
FROM defects
LEFT JOIN severities USING (severity_rule, severity)
LEFT JOIN defect_tracks USING (building_id, campaign_id, defect_id)
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
ORDER BY
    coalesce(severity_rank, 99),
    extent_m DESC,
    defect_id
LIMIT coalesce($limit::BIGINT, 20)
