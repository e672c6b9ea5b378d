-- grain: track
-- meaning: the defects that appeared since a campaign or a date: those that are new (their place was imaged before, without them), then those seen for the first time (their place was not imaged well enough before, so that their age is unknown)
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $since_campaign [campaigns.campaign_id]: the campaign since which; left out, the one before the latest
-- $since_date [date]: or the date since which (its end, UTC), such as 2026-04-30: campaigns that were flown later
WITH since AS (
    SELECT
        building_id,
        CASE
            WHEN $since_campaign::VARCHAR IS NOT NULL AND $since_date::DATE IS NOT NULL
                THEN error('since_campaign and since_date are both given; give one of them')
            WHEN $since_campaign::VARCHAR IS NOT NULL
                THEN max(campaign_number) FILTER (campaign_id = $since_campaign)
            WHEN $since_date::DATE IS NOT NULL
                THEN coalesce(max(campaign_number) FILTER (captured_from < $since_date::DATE + INTERVAL 1 DAY), 0)
            ELSE max(campaign_number) - 1
        END AS since_number
    FROM campaign_order
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
    GROUP BY building_id
)
SELECT
    s.building_id,
    s.campaign_id,
    o.captured_from,
    s.track_id,
    s.track_state,
    s.state_evidence,
    t.track_state AS current_state,
    t.defect_class,
    t.severity,
    round(greatest(t.width_m, t.height_m), 3) AS extent_m,
    round(t.area_m2, 4) AS area_m2,
    t.crack_width_mm,
    t.facade,
    t.storey,
    t.element_name,
    t.element_guid,
    s.defect_id,
    t.best_photo_uri,
    s.state_remark
FROM track_states AS s
JOIN campaign_order AS o USING (building_id, campaign_id)
JOIN since USING (building_id)
JOIN tracks AS t ON t.building_id = s.building_id AND t.track_id = s.track_id
LEFT JOIN severities AS r ON r.severity_rule = t.severity_rule AND r.severity = t.severity
WHERE s.track_state IN ('new', 'first_seen')
  AND o.campaign_number > since.since_number
ORDER BY
    s.building_id,
    s.track_state = 'first_seen',
    coalesce(r.severity_rank, 99),
    greatest(t.width_m, t.height_m) DESC,
    s.track_id
