-- grain: outcome and class
-- meaning: what became of the detections: registered, or why not
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    stage,
    outcome,
    coalesce(defect_class, source_class) AS class,
    count(*) AS detections
FROM detection_outcomes
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
GROUP BY ALL
ORDER BY building_id, campaign_id, detections DESC, outcome, class
