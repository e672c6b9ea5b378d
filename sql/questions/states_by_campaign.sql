-- grain: campaign
-- meaning: what each campaign says of the defects known by then: how many are new, grown, repaired, not found, not imaged and so on, the campaigns in order of their capture
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    s.building_id,
    s.campaign_id,
    any_value(o.captured_from) AS captured_from,
    count(*) AS tracks,
    count(*) FILTER (s.track_state = 'new') AS new,
    count(*) FILTER (s.track_state = 'first_seen') AS first_seen,
    count(*) FILTER (s.track_state = 'seen') AS seen,
    count(*) FILTER (s.track_state = 'grown') AS grown,
    count(*) FILTER (s.track_state = 'shrunk') AS shrunk,
    count(*) FILTER (s.track_state = 'reopened') AS reopened,
    count(*) FILTER (s.track_state = 'repaired') AS repaired,
    count(*) FILTER (s.track_state = 'not_found') AS not_found,
    count(*) FILTER (s.track_state = 'not_imaged') AS not_imaged,
    count(*) FILTER (s.reviewer IS NOT NULL) AS reviewed
FROM track_states AS s
JOIN campaign_order AS o USING (building_id, campaign_id)
WHERE ($building_id::VARCHAR IS NULL OR s.building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR s.campaign_id = $campaign_id)
GROUP BY s.building_id, s.campaign_id
ORDER BY s.building_id, any_value(o.campaign_number)
