-- grain: commit and campaign
-- meaning: the lake's versions up to the one asked, with the time (UTC), what each has brought, the run and the code that made it, or what regraded or who reviewed it; the history of a building by itself is of no campaign
SELECT
    version,
    committed_at,
    building_id,
    campaign_id,
    CASE
        WHEN tracked THEN concat('history of ', building_id)
        WHEN regraded_by IS NOT NULL THEN concat('grades of ', building_id)
        WHEN reviewed_by IS NOT NULL THEN concat('reviews of ', building_id)
        ELSE concat('campaign ', campaign_id, ' of ', building_id)
    END AS content,
    run_id,
    code_sha256,
    regraded_by,
    reviewed_by
FROM (
    SELECT
        snapshot_id AS version,
        snapshot_time AS committed_at,
        json_extract_string(commit_extra_info, '$.building_id') AS building_id,
        unnest(
            CASE
                WHEN json_exists(commit_extra_info, '$.campaigns')
                    THEN json_extract_string(commit_extra_info, '$.campaigns[*]')
                ELSE [json_extract_string(commit_extra_info, '$.campaign_id')]
            END
        ) AS campaign_id,
        json_extract_string(commit_extra_info, '$.run_id') AS run_id,
        json_extract_string(commit_extra_info, '$.code_sha256') AS code_sha256,
        json_extract_string(commit_extra_info, '$.rules') AS regraded_by,
        json_extract_string(commit_extra_info, '$.reviewed_by') AS reviewed_by,
        coalesce(json_extract_string(commit_extra_info, '$.tracked') = 'true', false) AS tracked
    FROM ducklake_snapshots('lake')
    WHERE commit_extra_info IS NOT NULL
      AND snapshot_id <= (SELECT id FROM ducklake_current_snapshot('lake'))
)
