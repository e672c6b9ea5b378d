-- grain: storey and class
-- meaning: how many defects of each class a storey has, how many of them severe (very_severe, UNSAFE, over_limit), and their area; the lowest first
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
WITH placed AS (
    SELECT
        *,
        min(height_map_m) OVER (PARTITION BY building_id, campaign_id, storey) AS storey_from_m
    FROM defects
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
      AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
)
SELECT
    building_id,
    campaign_id,
    coalesce(storey, '(no storey)') AS storey,
    defect_class,
    count(*) AS defects,
    count(*) FILTER (severity IN ('severe', 'very_severe', 'UNSAFE', 'over_limit')) AS severe,
    round(sum(area_m2), 3) AS area_m2
FROM placed
GROUP BY building_id, campaign_id, storey, storey_from_m, defect_class
ORDER BY building_id, campaign_id, storey_from_m, defect_class
