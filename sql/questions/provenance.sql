-- grain: campaign
-- meaning: what the lake knows of each campaign, and by which model, code and rules; with --as-of, what it knew on a date: defects, states of the tracks, and the runs that made them
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
WITH made AS (
    SELECT
        building_id,
        campaign_id,
        max(version) AS version,
        max(committed_at) AS committed_at,
        count(*) FILTER (reviewed_by IS NOT NULL) AS reviews
    FROM versions
    GROUP BY building_id, campaign_id
),
-- Versions of an earlier Facadelake do not tell their code, but the run does.
tracked AS (
    SELECT
        v.building_id,
        v.version AS history_version,
        v.content AS history_content,
        coalesce(v.code_sha256, r.code_sha256) AS history_code_sha256
    FROM versions AS v
    LEFT JOIN runs AS r ON r.building_id = v.building_id AND r.campaign_id = v.campaign_id AND r.run_id = v.run_id
    WHERE v.regraded_by IS NULL AND v.reviewed_by IS NULL
    QUALIFY row_number() OVER (PARTITION BY v.building_id ORDER BY v.version DESC) = 1
),
models AS (
    SELECT building_id, campaign_id, string_agg(DISTINCT detector, ', ' ORDER BY detector) AS detectors
    FROM detections
    GROUP BY building_id, campaign_id
),
graded AS (
    SELECT
        building_id,
        campaign_id,
        string_agg(DISTINCT severity_rule, ', ' ORDER BY severity_rule) AS severity_rules,
        count(*) FILTER (graded_by <> 'rules') AS graded_by_person
    FROM defects
    GROUP BY building_id, campaign_id
),
states AS (
    SELECT
        building_id,
        campaign_id,
        count(*) AS tracks,
        count(*) FILTER (track_state IN ('new', 'first_seen')) AS appeared,
        count(*) FILTER (track_state = 'grown') AS grown,
        count(*) FILTER (track_state = 'reopened') AS reopened,
        count(*) FILTER (track_state = 'repaired') AS repaired
    FROM track_states
    GROUP BY building_id, campaign_id
)
SELECT
    c.building_id,
    c.campaign_id,
    c.captured_from,
    m.version,
    m.committed_at,
    r.run_id,
    r.finished_at,
    r.facadelake_version,
    r.code_sha256,
    d.detectors,
    r.detector_sha256,
    b.model_sha256 AS building_model_sha256,
    g.severity_rules,
    g.graded_by_person,
    m.reviews,
    c.photos_localised,
    c.defects_total,
    CASE WHEN s.tracks IS NOT NULL THEN h.history_version END AS history_version,
    CASE WHEN s.tracks IS NOT NULL THEN h.history_content END AS history_content,
    CASE WHEN s.tracks IS NOT NULL THEN h.history_code_sha256 END AS history_code_sha256,
    s.tracks,
    s.appeared,
    s.grown,
    s.reopened,
    s.repaired
FROM campaigns AS c
JOIN campaign_order AS o USING (building_id, campaign_id)
JOIN runs AS r USING (building_id, campaign_id)
JOIN buildings AS b USING (building_id, campaign_id)
LEFT JOIN made AS m USING (building_id, campaign_id)
LEFT JOIN tracked AS h USING (building_id)
LEFT JOIN models AS d USING (building_id, campaign_id)
LEFT JOIN graded AS g USING (building_id, campaign_id)
LEFT JOIN states AS s USING (building_id, campaign_id)
WHERE ($building_id::VARCHAR IS NULL OR c.building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR c.campaign_id = $campaign_id)
ORDER BY c.building_id, o.campaign_number
