-- grain: repair of a track
-- meaning: each repair: the campaign that found the defect gone, the last one before in which it was there, later ones in which it was still gone, and the one in which it was there again
WITH informative AS (
    SELECT
        s.*,
        o.captured_from,
        o.campaign_number,
        lag(s.track_state) OVER in_order AS state_before,
        lag(s.campaign_id) OVER in_order AS campaign_before
    FROM track_states AS s
    JOIN campaign_order AS o USING (building_id, campaign_id)
    WHERE s.track_state NOT IN ('not_found', 'not_imaged')
    WINDOW in_order AS (PARTITION BY s.building_id, s.track_id ORDER BY o.campaign_number)
),
numbered AS (
    SELECT
        *,
        count(*) FILTER (track_state = 'repaired' AND state_before IS DISTINCT FROM 'repaired') OVER (
            PARTITION BY building_id, track_id ORDER BY campaign_number
        ) AS repair_number
    FROM informative
)
SELECT
    building_id,
    min_by(campaign_id, campaign_number) AS campaign_id,
    track_id,
    repair_number,
    min_by(campaign_before, campaign_number) AS there_before,
    min_by(state_evidence, campaign_number) AS state_evidence,
    min_by(reviewer, campaign_number) AS reviewer,
    count(*) FILTER (track_state = 'repaired') - 1 AS confirmed_count,
    min_by(campaign_id, campaign_number) FILTER (track_state <> 'repaired') AS reopened_campaign,
    (epoch(min(captured_from) FILTER (track_state <> 'repaired')) - epoch(min_by(captured_from, campaign_number)))
    / (365.25 * 86400) AS years_until_reopened
FROM numbered
WHERE repair_number > 0
GROUP BY building_id, track_id, repair_number
