-- grain: campaign
-- meaning: how each campaign was placed and how well: control, sigma, held-out points, GPS, bend, remarks
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    control,
    method,
    points_used,
    points_total,
    round(residual_mean_m, 4) AS residual_mean_m,
    round(sigma_east_m, 4) AS sigma_east_m,
    round(sigma_north_m, 4) AS sigma_north_m,
    round(sigma_up_m, 4) AS sigma_up_m,
    check_points,
    round(check_residual_mean_m, 4) AS check_residual_mean_m,
    round(check_residual_max_m, 4) AS check_residual_max_m,
    round(gps_offset_east_m, 2) AS gps_offset_east_m,
    round(gps_offset_north_m, 2) AS gps_offset_north_m,
    round(gps_offset_up_m, 2) AS gps_offset_up_m,
    round(doming_m, 4) AS doming_m,
    round(doming_sigma_m, 4) AS doming_sigma_m,
    reference_campaign,
    remarks
FROM georeference
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
ORDER BY building_id, campaign_id
