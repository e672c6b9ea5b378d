-- grain: campaign
-- meaning: what an inspection found: defects, those with the worst grade of their rule pack, and the states of the building's tracks in the campaign
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
WITH graded AS (
    SELECT
        d.building_id,
        d.campaign_id,
        min(s.severity) FILTER (s.severity_rank = 1) AS worst_severity,
        count(*) FILTER (s.severity_rank = 1) AS worst_defects
    FROM defects AS d
    LEFT JOIN severities AS s USING (severity_rule, severity)
    GROUP BY d.building_id, d.campaign_id
),
states AS (
    SELECT
        building_id,
        campaign_id,
        count(*) FILTER (track_state = 'new') AS new,
        count(*) FILTER (track_state = 'first_seen') AS first_seen,
        count(*) FILTER (track_state = 'seen') AS seen,
        count(*) FILTER (track_state = 'grown') AS grown,
        count(*) FILTER (track_state = 'shrunk') AS shrunk,
        count(*) FILTER (track_state = 'reopened') AS reopened,
        count(*) FILTER (track_state = 'repaired') AS repaired,
        count(*) FILTER (track_state = 'not_found') AS not_found,
        count(*) FILTER (track_state = 'not_imaged') AS not_imaged
    FROM track_states
    GROUP BY building_id, campaign_id
)
SELECT
    c.building_id,
    c.campaign_id,
    c.defects_total,
    g.worst_severity,
    coalesce(g.worst_defects, 0) AS worst_defects,
    s.* EXCLUDE (building_id, campaign_id)
FROM campaigns AS c
JOIN campaign_order AS o USING (building_id, campaign_id)
LEFT JOIN graded AS g USING (building_id, campaign_id)
LEFT JOIN states AS s USING (building_id, campaign_id)
WHERE ($building_id::VARCHAR IS NULL OR c.building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR c.campaign_id = $campaign_id)
ORDER BY c.building_id, o.campaign_number
