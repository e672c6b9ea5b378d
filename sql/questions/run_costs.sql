-- grain: run
-- meaning: the trend of what inspections cost, by building in order of the runs: time of the stages that were made (those from the cache take none), photographs per second, peak memory, and the last two against their mean over the building's runs before. Speed and trend are of runs that read their photographs; a run that was replaced is in earlier versions (--as-of)
-- $building_id [campaigns.building_id]: the building; left out, all of them
WITH costs AS (
    SELECT
        r.building_id,
        r.campaign_id,
        r.run_id,
        r.started_at,
        r.facadelake_version,
        c.photos_total,
        len(json_keys(r.stage_seconds)) AS stages_made,
        len(json_keys(coalesce(r.stage_keys, r.stage_seconds))) AS stages,
        json_exists(r.stage_seconds, '$.ingest') AS is_whole,
        epoch(r.finished_at) - epoch(r.started_at) AS run_s,
        list_sum(map_values(json_transform(r.stage_seconds, '"MAP(VARCHAR, DOUBLE)"'))) AS stages_s,
        list_max(map_values(json_transform(r.stage_peak_mib, '"MAP(VARCHAR, DOUBLE)"'))) AS peak_mib
    FROM runs AS r
    JOIN campaigns AS c USING (building_id, campaign_id)
    WHERE ($building_id::VARCHAR IS NULL OR r.building_id = $building_id)
),
speeds AS (
    SELECT *, CASE WHEN is_whole THEN photos_total / nullif(stages_s, 0) END AS photos_per_s FROM costs
)
SELECT
    building_id,
    campaign_id,
    run_id,
    started_at,
    facadelake_version,
    photos_total,
    stages_made,
    stages,
    round(run_s, 1) AS run_s,
    round(stages_s, 1) AS stages_s,
    round(photos_per_s, 3) AS photos_per_s,
    round(peak_mib) AS peak_mib,
    CASE WHEN is_whole THEN round(photos_per_s / avg(photos_per_s) OVER before, 2) END AS speed_ratio,
    CASE WHEN is_whole THEN round(peak_mib / avg(peak_mib) OVER before, 2) END AS peak_ratio
FROM speeds
WINDOW before AS (
    PARTITION BY building_id, is_whole ORDER BY started_at ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
)
ORDER BY building_id, started_at
