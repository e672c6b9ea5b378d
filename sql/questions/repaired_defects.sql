-- grain: repair of a track
-- meaning: what was repaired, and whether it held: reopened, holds (a later campaign imaged the place, and it was still gone), or not_checked (no later campaign imaged it)
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign that found the repair; left out, all of them
SELECT
    p.building_id,
    p.campaign_id,
    p.track_id,
    t.defect_class,
    CASE
        WHEN p.reopened_campaign IS NOT NULL THEN 'reopened'
        WHEN p.confirmed_count > 0 THEN 'holds'
        ELSE 'not_checked'
    END AS repair_outcome,
    p.there_before,
    p.reopened_campaign,
    round(p.years_until_reopened, 2) AS years_until_reopened,
    p.confirmed_count,
    p.state_evidence,
    p.reviewer,
    t.track_state AS current_state,
    t.severity,
    t.facade,
    t.storey,
    t.element_name,
    t.element_guid
FROM repairs AS p
JOIN tracks AS t ON t.building_id = p.building_id AND t.track_id = p.track_id
WHERE ($building_id::VARCHAR IS NULL OR p.building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR p.campaign_id = $campaign_id)
ORDER BY
    p.building_id,
    p.reopened_campaign IS NULL,
    p.confirmed_count > 0,
    p.track_id,
    p.repair_number
