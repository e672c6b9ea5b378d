-- grain: track
-- meaning: two campaigns side by side: what became of each defect, the later campaign against the earlier one, in the words of 'facadelake compare'; classes, severities and sizes of the detections that stand for both (the latest one up to the earlier campaign, and the latest one since), sizes as tracking compares them: medians of the sightings; the change with its sigma, without what all sizes of a campaign share, where one detection alone lies after the earlier campaign. Where there are more, whether the size changed beyond the errors is for 'facadelake compare' to tell, and the finding is 'there in both'. What matters most comes first. Of several buildings, without those for which that cannot be
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $from_campaign [campaigns.campaign_id]: the earlier campaign; left out, the one before the later
-- $to_campaign [campaigns.campaign_id]: the later campaign; left out, the latest
WITH known AS (
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
medians AS (
    SELECT
        building_id,
        campaign_id,
        defect_id,
        exp(median(ln(length_m)) FILTER (length_m > 0)) AS length_m,
        exp(median(ln(area_m2)) FILTER (area_m2 > 0)) AS area_m2
    FROM observations
    WHERE defect_id IS NOT NULL
    GROUP BY building_id, campaign_id, defect_id
),
states AS (
    SELECT
        s.* EXCLUDE (defect_class),
        k.campaign_number,
        s.track_state IN ('new', 'first_seen', 'seen', 'grown', 'shrunk', 'reopened') AS is_there,
        coalesce(d.defect_class, s.defect_class) AS defect_class,
        d.severity,
        coalesce(m.length_m, d.length_m) AS length_m,
        coalesce(m.area_m2, d.area_m2) AS area_m2,
        d.crack_width_mm,
        d.crack_width_sigma_mm
    FROM track_states AS s
    JOIN known AS k USING (building_id, campaign_id)
    LEFT JOIN defects AS d USING (building_id, campaign_id, defect_id)
    LEFT JOIN medians AS m USING (building_id, campaign_id, defect_id)
),
spans AS (
    SELECT
        s.building_id,
        s.track_id,
        arg_max(campaign_id, campaign_number) FILTER (NOT is_since AND defect_id IS NOT NULL) AS detected_from,
        arg_max(campaign_id, campaign_number) FILTER (is_since AND defect_id IS NOT NULL) AS detected_to,
        count(defect_id) FILTER (is_since) AS detections,
        coalesce(
            arg_max(track_state, campaign_number) FILTER (NOT is_since AND (is_there OR track_state = 'repaired')), ''
        ) = 'repaired' AS was_repaired,
        count(*) FILTER (is_since AND is_there) > 0 AS was_open,
        count(*) FILTER (is_since AND track_state IN ('repaired', 'reopened')) > 0 AS was_broken,
        count(*) FILTER (is_since AND track_state = 'new') > 0 AS is_new,
        max(track_state) FILTER (is_since AND track_state IN ('grown', 'shrunk')) AS step,
        string_agg(
            replace(track_state, '_', ' ') || ' in ' || campaign_id, ', ' ORDER BY campaign_number
        ) FILTER (
            is_since AND campaign_number < to_number AND track_state NOT IN ('seen', 'not_found', 'not_imaged')
        ) AS happened_between
    FROM (
        SELECT s.*, c.to_number, s.campaign_number > c.from_number AS is_since
        FROM states AS s
        JOIN chosen AS c ON c.building_id = s.building_id AND s.campaign_number <= c.to_number
    ) AS s
    GROUP BY s.building_id, s.track_id
),
found AS (
    SELECT
        p.*,
        c.from_campaign,
        c.to_campaign,
        e.track_state AS state_from,
        l.track_state AS state_to,
        l.state_evidence AS evidence_to,
        CASE
            WHEN l.track_state = 'repaired' AND p.was_repaired AND NOT p.was_open THEN 'still repaired'
            WHEN NOT l.is_there THEN replace(l.track_state, '_', ' ')
            WHEN p.was_repaired THEN 'reopened'
            WHEN e.track_state IS NULL AND p.is_new THEN 'new'
            WHEN e.track_state IS NULL THEN 'first seen'
            WHEN p.was_broken THEN 'repaired between'
            WHEN l.track_state IN ('grown', 'shrunk') AND l.state_evidence = 'review' THEN l.track_state
            WHEN p.detections < 2 AND p.step IS NOT NULL THEN p.step
            WHEN b.defect_class <> a.defect_class THEN 'class changed'
            WHEN p.detections > 1 THEN 'there in both'
            WHEN b.severity <> a.severity THEN 'regraded'
            WHEN l.track_state = 'seen' AND l.state_evidence = 'looks_the_same' THEN 'missed by the detector'
            ELSE 'unchanged'
        END AS finding,
        l.is_there AND p.detections = 1 AS is_one_step,
        b.defect_id AS defect_from,
        a.defect_id AS defect_to,
        coalesce(a.defect_class, b.defect_class, l.defect_class) AS defect_class,
        b.defect_class AS class_from,
        b.severity AS severity_from,
        a.severity AS severity_to,
        b.length_m AS length_from_m,
        a.length_m AS length_to_m,
        b.area_m2 AS area_from_m2,
        a.area_m2 AS area_to_m2,
        b.crack_width_mm AS crack_width_from_mm,
        b.crack_width_sigma_mm AS crack_width_from_sigma_mm,
        a.crack_width_mm AS crack_width_to_mm,
        a.crack_width_sigma_mm AS crack_width_to_sigma_mm,
        a.changed_quantity,
        a.length_change_m,
        a.length_change_sigma_m,
        a.area_change_m2,
        a.area_change_sigma_m2,
        a.crack_width_change_mm,
        a.crack_width_change_sigma_mm
    FROM spans AS p
    JOIN chosen AS c USING (building_id)
    JOIN states AS l
        ON l.building_id = p.building_id AND l.track_id = p.track_id AND l.campaign_id = c.to_campaign
    LEFT JOIN states AS e
        ON e.building_id = p.building_id AND e.track_id = p.track_id AND e.campaign_id = c.from_campaign
    LEFT JOIN states AS b
        ON b.building_id = p.building_id AND b.track_id = p.track_id AND b.campaign_id = p.detected_from
    LEFT JOIN states AS a
        ON a.building_id = p.building_id AND a.track_id = p.track_id AND a.campaign_id = p.detected_to
),
ranked AS (
    SELECT
        *,
        list_position(
            [
                'reopened', 'repaired between', 'grown', 'class changed', 'new', 'first seen', 'regraded', 'not imaged',
                'not found', 'missed by the detector', 'shrunk', 'repaired', 'there in both', 'unchanged',
                'still repaired'
            ],
            finding
        ) AS finding_rank
    FROM found
)
SELECT
    building_id,
    f.from_campaign,
    f.to_campaign,
    track_id,
    f.finding,
    f.happened_between,
    f.class_from,
    f.defect_class,
    t.severity,
    f.severity_from,
    f.severity_to,
    f.state_from,
    f.state_to,
    f.evidence_to,
    f.detected_from,
    f.defect_from,
    f.detected_to,
    f.defect_to,
    round(f.length_from_m, 3) AS length_from_m,
    round(f.length_to_m, 3) AS length_to_m,
    round(f.area_from_m2, 4) AS area_from_m2,
    round(f.area_to_m2, 4) AS area_to_m2,
    f.crack_width_from_mm,
    f.crack_width_from_sigma_mm,
    f.crack_width_to_mm,
    f.crack_width_to_sigma_mm,
    CASE WHEN f.is_one_step THEN f.changed_quantity END AS changed_quantity,
    CASE WHEN f.is_one_step THEN round(f.length_change_m, 4) END AS length_change_m,
    CASE WHEN f.is_one_step THEN round(f.length_change_sigma_m, 4) END AS length_change_sigma_m,
    CASE WHEN f.is_one_step THEN round(f.area_change_m2, 4) END AS area_change_m2,
    CASE WHEN f.is_one_step THEN round(f.area_change_sigma_m2, 4) END AS area_change_sigma_m2,
    CASE WHEN f.is_one_step THEN round(f.crack_width_change_mm, 3) END AS crack_width_change_mm,
    CASE WHEN f.is_one_step THEN round(f.crack_width_change_sigma_mm, 3) END AS crack_width_change_sigma_mm,
    t.facade,
    t.storey,
    t.element_name
FROM ranked AS f
JOIN tracks AS t USING (building_id, track_id)
LEFT JOIN severities AS r ON r.severity_rule = t.severity_rule AND r.severity = t.severity
ORDER BY
    building_id,
    CASE WHEN f.finding_rank <= 4 THEN 0 ELSE f.finding_rank END,
    coalesce(r.severity_rank, 99),
    f.finding_rank,
    t.area_m2 DESC,
    track_id
