-- grain: commit and campaign
-- meaning: the lake's versions up to the one asked, with the time (UTC), the run that made each, or what regraded or who reviewed it
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
    json_extract_string(commit_extra_info, '$.rules') AS regraded_by,
    json_extract_string(commit_extra_info, '$.reviewed_by') AS reviewed_by
FROM ducklake_snapshots('lake')
WHERE commit_extra_info IS NOT NULL
  AND snapshot_id <= (SELECT id FROM ducklake_current_snapshot('lake'))
