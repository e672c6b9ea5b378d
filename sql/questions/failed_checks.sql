-- grain: expectation
-- meaning: checks before the commit that were not met; a committed campaign has none
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    table_name,
    expectation,
    column_name,
    unexpected,
    detail
FROM checks
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
  AND NOT passed
ORDER BY ALL
