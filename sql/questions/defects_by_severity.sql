-- grain: severity and class
-- meaning: how many defects have which severity by which rule pack, the worst first, and who graded them
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    severity_rule,
    severity,
    coalesce(graded_by, 'rules') AS graded_by,
    defect_class,
    count(*) AS defects
FROM defects
LEFT JOIN severities USING (severity_rule, severity)
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
GROUP BY ALL
ORDER BY building_id, campaign_id, severity_rule, coalesce(min(severity_rank), 99), graded_by, defect_class
