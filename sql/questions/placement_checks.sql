-- grain: statement about a campaign's place
-- meaning: what GPS, surveyed points and the model say about the placement of a campaign, disagreements first, then accepted ones
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    statement,
    placement_check_outcome AS outcome,
    round(deviation, 3) AS deviation,
    round(deviation_sigma, 3) AS sigma,
    round(deviation_limit, 3) AS limit_of_deviation,
    deviation_unit AS unit,
    detail
FROM placement_checks
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
ORDER BY
    building_id,
    campaign_id,
    placement_check_outcome <> 'disagrees',
    placement_check_outcome <> 'accepted',
    statement
