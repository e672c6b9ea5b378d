-- grain: facade and class
-- meaning: how many defects of each class a facade has, how many of them severe (very_severe, UNSAFE, over_limit), and their area
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    facade,
    defect_class,
    count(*) AS defects,
    count(*) FILTER (severity IN ('severe', 'very_severe', 'UNSAFE', 'over_limit')) AS severe,
    round(sum(area_m2), 3) AS area_m2
FROM defects
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
GROUP BY ALL
ORDER BY building_id, campaign_id, facade, defect_class
