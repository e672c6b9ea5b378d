-- grain: facade and storey
-- meaning: how much of each facade the photographs show, by storey, why the rest is not imaged, and how well the imaged part is; found_crack_width_mm is found on the whole searched surface
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    facade,
    coalesce(storey, '(no storey)') AS storey,
    round(sum(area_m2), 2) AS surface_m2,
    round(coalesce(sum(area_m2) FILTER (imaged_count > 0), 0) / sum(area_m2), 4) AS imaged_share,
    round(coalesce(sum(area_m2) FILTER (searched_count > 0), 0) / sum(area_m2), 4) AS searched_share,
    round(coalesce(sum(area_m2) FILTER (coverage_outcome = 'obstructed'), 0), 2) AS obstructed_m2,
    round(coalesce(sum(area_m2) FILTER (coverage_outcome = 'grazing'), 0), 2) AS grazing_m2,
    round(coalesce(sum(area_m2) FILTER (coverage_outcome = 'hidden_by_model'), 0), 2) AS hidden_by_model_m2,
    round(coalesce(sum(area_m2) FILTER (coverage_outcome = 'not_in_view'), 0), 2) AS not_in_view_m2,
    round(median(gsd_mm), 2) AS gsd_median_mm,
    CASE
        WHEN bool_and(found_crack_width_mm IS NOT NULL) FILTER (searched_count > 0)
            THEN round(max(found_crack_width_mm), 2)
    END AS found_crack_width_mm
FROM coverage
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
GROUP BY building_id, campaign_id, facade, storey
ORDER BY building_id, campaign_id, facade, median(z_site_m) DESC, storey
