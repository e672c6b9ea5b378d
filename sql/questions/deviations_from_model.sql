-- grain: defect
-- meaning: where triangulated defects stand off the building model by more than twice its sigma, the most first
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
-- $limit [number]: rows at most; left out, 50
SELECT
    building_id,
    campaign_id,
    defect_id,
    track_id,
    defect_class,
    round(deviation_from_model_m, 3) AS deviation_from_model_m,
    round(deviation_sigma_m, 3) AS deviation_sigma_m,
    round(abs(deviation_from_model_m) / deviation_sigma_m, 1) AS sigmas,
    photo_count,
    ifc_class,
    element_name,
    element_guid,
    storey,
    facade,
    captured_to,
    best_photo_id,
    best_photo_uri
FROM defects
LEFT JOIN defect_tracks USING (building_id, campaign_id, defect_id)
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
  AND abs(deviation_from_model_m) > 2 * deviation_sigma_m
ORDER BY building_id, campaign_id, abs(deviation_from_model_m) DESC, defect_id
LIMIT coalesce($limit::BIGINT, 50)
