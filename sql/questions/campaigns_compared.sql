-- grain: track
-- meaning: two campaigns side by side, as 'facadelake compare' has them: what became of each defect between them, its state and its sizes in both, and the change of its size since changed_since with its sigma, without what all sizes of a campaign share; over several campaigns the changes between are summed, and their variances; what matters most comes first. Of several buildings, without those for which that cannot be
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $from_campaign [campaigns.campaign_id]: the earlier campaign; left out, the one before the later
-- $to_campaign [campaigns.campaign_id]: the later campaign; left out, the latest
WITH RECURSIVE known AS (
    SELECT *, string_agg(campaign_id, ', ' ORDER BY campaign_number) OVER (PARTITION BY building_id) AS all_campaigns
    FROM campaign_order
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
),
untracked AS (
    SELECT
        k.building_id,
        k.campaign_id,
        coalesce(
            o.detail,
            format('the lake has no history of it; run ''facadelake track {}''', k.building_id)
        ) AS why
    FROM known AS k
    LEFT JOIN frame_offsets AS o ON o.building_id = k.building_id AND o.campaign_id = k.campaign_id AND o.facade = ''
    LEFT JOIN (SELECT DISTINCT building_id, campaign_id, true AS has_states FROM track_states) AS s
        ON s.building_id = k.building_id AND s.campaign_id = k.campaign_id
    WHERE o.offset_outcome = 'refused' OR (o.offset_outcome IS NULL AND s.has_states IS NULL)
),
pairs AS (
    SELECT
        l.building_id,
        e.campaign_id AS from_campaign,
        l.campaign_id AS to_campaign,
        e.campaign_number AS from_number,
        l.campaign_number AS to_number,
        CASE
            WHEN e.campaign_id IS NULL AND $from_campaign IS NOT NULL
                THEN format('no building has both campaign ''{}'' and ''{}''', $from_campaign, l.campaign_id)
            WHEN e.campaign_id IS NULL AND l.campaign_id = l.all_campaigns
                THEN format(
                    'building ''{}'' has one campaign in the lake ({}), and a comparison needs two; inspect the next '
                    || 'one first', l.building_id, l.campaign_id
                )
            WHEN e.campaign_id IS NULL
                THEN format(
                    'campaign ''{}'' is the first of ''{}''; there is none before it', l.campaign_id, l.building_id
                )
            WHEN e.campaign_number >= l.campaign_number
                THEN format(
                    'campaign ''{}'' was not photographed before ''{}''; name the earlier one first (in order: {})',
                    e.campaign_id, l.campaign_id, l.all_campaigns
                )
            WHEN f.why IS NOT NULL OR u.why IS NOT NULL
                THEN format(
                    'campaign ''{}'' of building ''{}'' is not tracked: {}',
                    coalesce(f.campaign_id, u.campaign_id), l.building_id, coalesce(f.why, u.why)
                )
        END AS obstacle
    FROM known AS l
    LEFT JOIN known AS e
        ON e.building_id = l.building_id AND e.campaign_id = coalesce($from_campaign::VARCHAR, l.campaign_before)
    LEFT JOIN untracked AS f ON f.building_id = e.building_id AND f.campaign_id = e.campaign_id
    LEFT JOIN untracked AS u ON u.building_id = l.building_id AND u.campaign_id = l.campaign_id
    WHERE CASE WHEN $to_campaign::VARCHAR IS NULL THEN l.is_latest ELSE l.campaign_id = $to_campaign END
),
chosen AS (
    SELECT building_id, from_campaign, to_campaign, from_number, to_number
    FROM (SELECT *, count(*) FILTER (obstacle IS NULL) OVER () AS comparable FROM pairs)
    WHERE CASE WHEN obstacle IS NULL THEN true WHEN comparable > 0 THEN false ELSE error(obstacle) END
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
),
-- What happened after the earlier campaign, up to the later one.
between_states AS (
    SELECT
        s.building_id,
        s.track_id,
        bool_and(s.track_state = 'repaired') AS always_repaired,
        bool_or(s.track_state = 'reopened') AS reopened,
        bool_or(s.track_state = 'new') AS is_new,
        count(*) FILTER (s.track_state = 'grown') - count(*) FILTER (s.track_state = 'shrunk') AS steps
    FROM track_states AS s
    JOIN known AS k USING (building_id, campaign_id)
    JOIN chosen AS c ON c.building_id = s.building_id
    WHERE k.campaign_number > c.from_number AND k.campaign_number <= c.to_number
    GROUP BY s.building_id, s.track_id
),
-- The detections with a change, from the later campaign back to the first that was compared with the earlier one.
changed AS (
    SELECT s.*, k.campaign_number AS previous_number
    FROM track_states AS s
    JOIN known AS k ON k.building_id = s.building_id AND k.campaign_id = s.previous_campaign
),
steps AS (
    SELECT s.*, c.from_number
    FROM changed AS s
    JOIN chosen AS c ON c.building_id = s.building_id AND c.to_campaign = s.campaign_id
    UNION ALL
    SELECT s.*, n.from_number
    FROM steps AS n
    JOIN changed AS s
        ON s.building_id = n.building_id AND s.track_id = n.track_id AND s.campaign_id = n.previous_campaign
    WHERE n.previous_number > n.from_number
),
changes AS (
    SELECT
        building_id,
        track_id,
        min_by(previous_campaign, previous_number) AS changed_since,
        string_agg(DISTINCT changed_quantity, ', ' ORDER BY changed_quantity) AS changed_quantity,
        CASE WHEN count(length_change_m) = count(*) THEN sum(length_change_m) END AS length_change_m,
        CASE
            WHEN count(length_change_sigma_m) = count(*) THEN sqrt(sum(length_change_sigma_m ** 2))
        END AS length_change_sigma_m,
        CASE WHEN count(area_change_m2) = count(*) THEN sum(area_change_m2) END AS area_change_m2,
        CASE
            WHEN count(area_change_sigma_m2) = count(*) THEN sqrt(sum(area_change_sigma_m2 ** 2))
        END AS area_change_sigma_m2,
        CASE WHEN count(crack_width_change_mm) = count(*) THEN sum(crack_width_change_mm) END AS crack_width_change_mm,
        CASE
            WHEN count(crack_width_change_sigma_mm) = count(*) THEN sqrt(sum(crack_width_change_sigma_mm ** 2))
        END AS crack_width_change_sigma_mm
    FROM steps
    GROUP BY building_id, track_id
),
found AS (
    SELECT
        l.building_id,
        l.track_id,
        CASE
            WHEN l.track_state = 'repaired' AND e.track_state = 'repaired' AND b.always_repaired THEN 'still repaired'
            WHEN l.track_state IN ('repaired', 'not_found', 'not_imaged') THEN replace(l.track_state, '_', ' ')
            WHEN b.reopened THEN 'reopened'
            WHEN e.track_state IS NULL AND b.is_new THEN 'new'
            WHEN e.track_state IS NULL THEN 'first seen'
            WHEN b.steps > 0 THEN 'grown'
            WHEN b.steps < 0 THEN 'shrunk'
            WHEN l.track_state = 'seen' AND l.state_evidence = 'looks_the_same' THEN 'missed by the detector'
            ELSE 'unchanged'
        END AS finding
    FROM later_states AS l
    JOIN between_states AS b USING (building_id, track_id)
    LEFT JOIN earlier_states AS e USING (building_id, track_id)
),
ranked AS (
    SELECT
        *,
        list_position(
            [
                'reopened', 'grown', 'new', 'first seen', 'not imaged', 'not found', 'missed by the detector', 'shrunk',
                'repaired', 'unchanged', 'still repaired'
            ],
            finding
        ) AS finding_rank
    FROM found
)
SELECT
    building_id,
    c.from_campaign,
    c.to_campaign,
    track_id,
    f.finding,
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
    s.changed_since,
    s.changed_quantity,
    round(s.length_change_m, 4) AS length_change_m,
    round(s.length_change_sigma_m, 4) AS length_change_sigma_m,
    round(s.area_change_m2, 4) AS area_change_m2,
    round(s.area_change_sigma_m2, 4) AS area_change_sigma_m2,
    round(s.crack_width_change_mm, 3) AS crack_width_change_mm,
    round(s.crack_width_change_sigma_mm, 3) AS crack_width_change_sigma_mm,
    t.facade,
    t.storey,
    t.element_name
FROM later_states AS l
JOIN ranked AS f USING (building_id, track_id)
JOIN chosen AS c USING (building_id)
JOIN tracks AS t USING (building_id, track_id)
LEFT JOIN earlier_states AS e USING (building_id, track_id)
LEFT JOIN changes AS s USING (building_id, track_id)
LEFT JOIN severities AS r ON r.severity_rule = t.severity_rule AND r.severity = t.severity
ORDER BY
    building_id,
    CASE WHEN f.finding IN ('reopened', 'grown') THEN 0 ELSE f.finding_rank END,
    coalesce(r.severity_rank, 99),
    f.finding_rank,
    t.area_m2 DESC,
    track_id
