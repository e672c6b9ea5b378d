-- grain: track
-- meaning: two campaigns side by side: the state and the sizes of each defect in both; changes with their sigma where the later campaign was compared with the earlier one (changed_since), without what all sizes of a campaign share; what matters most comes first
-- $building_id: the building; left out, all of them
-- $from_campaign: the earlier campaign; left out, the one before the later
-- $to_campaign: the later campaign; left out, the latest
WITH later AS (
    SELECT building_id, campaign_id AS to_campaign, campaign_before
    FROM campaign_order
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
      AND CASE WHEN $to_campaign::VARCHAR IS NULL THEN is_latest ELSE campaign_id = $to_campaign END
),
chosen AS (
    SELECT building_id, to_campaign, coalesce($from_campaign::VARCHAR, campaign_before) AS from_campaign FROM later
),
sized AS (
    SELECT s.*, d.length_m, d.area_m2, d.crack_width_mm, d.crack_width_sigma_mm
    FROM track_states AS s
    LEFT JOIN defects AS d USING (building_id, campaign_id, defect_id)
),
earlier_states AS (
    SELECT s.* FROM sized AS s JOIN chosen AS c ON c.building_id = s.building_id AND c.from_campaign = s.campaign_id
),
later_states AS (
    SELECT s.* FROM sized AS s JOIN chosen AS c ON c.building_id = s.building_id AND c.to_campaign = s.campaign_id
)
SELECT
    building_id,
    c.from_campaign,
    c.to_campaign,
    track_id,
    coalesce(l.defect_class, e.defect_class) AS defect_class,
    t.severity,
    e.track_state AS state_from,
    l.track_state AS state_to,
    l.state_evidence AS evidence_to,
    e.defect_id AS defect_from,
    l.defect_id AS defect_to,
    round(e.length_m, 3) AS length_from_m,
    round(l.length_m, 3) AS length_to_m,
    round(e.area_m2, 4) AS area_from_m2,
    round(l.area_m2, 4) AS area_to_m2,
    e.crack_width_mm AS crack_width_from_mm,
    e.crack_width_sigma_mm AS crack_width_from_sigma_mm,
    l.crack_width_mm AS crack_width_to_mm,
    l.crack_width_sigma_mm AS crack_width_to_sigma_mm,
    l.previous_campaign AS changed_since,
    l.changed_quantity,
    CASE WHEN l.previous_campaign = c.from_campaign THEN round(l.length_change_m, 4) END AS length_change_m,
    CASE WHEN l.previous_campaign = c.from_campaign THEN round(l.length_change_sigma_m, 4) END AS length_change_sigma_m,
    CASE WHEN l.previous_campaign = c.from_campaign THEN round(l.area_change_m2, 4) END AS area_change_m2,
    CASE WHEN l.previous_campaign = c.from_campaign THEN round(l.area_change_sigma_m2, 4) END AS area_change_sigma_m2,
    CASE WHEN l.previous_campaign = c.from_campaign THEN round(l.crack_width_change_mm, 3) END AS crack_width_change_mm,
    CASE
        WHEN l.previous_campaign = c.from_campaign THEN round(l.crack_width_change_sigma_mm, 3)
    END AS crack_width_change_sigma_mm,
    t.facade,
    t.storey,
    t.element_name
FROM earlier_states AS e
FULL JOIN later_states AS l USING (building_id, track_id)
JOIN chosen AS c USING (building_id)
JOIN tracks AS t USING (building_id, track_id)
LEFT JOIN severities AS r ON r.severity_rule = t.severity_rule AND r.severity = t.severity
ORDER BY
    building_id,
    coalesce(
        list_position(
            ['grown', 'reopened', 'new', 'first_seen', 'repaired', 'not_found', 'not_imaged', 'shrunk', 'seen'],
            l.track_state
        ),
        10
    ),
    coalesce(r.severity_rank, 99),
    t.area_m2 DESC,
    track_id
