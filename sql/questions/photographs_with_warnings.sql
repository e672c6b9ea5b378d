-- grain: photograph
-- meaning: photographs whose metadata are damaged, ambiguous or contradictory, and how they were taken
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    photo_id,
    prior_source,
    prior_sigma_horizontal_m,
    prior_sigma_vertical_m,
    prior_warnings AS warnings
FROM photos
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
  AND prior_warnings IS NOT NULL
ORDER BY building_id, campaign_id, photo_id
