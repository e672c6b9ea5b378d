-- grain: commit
-- meaning: the lake's versions, the time (UTC) of each and the run that made it
SELECT
    snapshot_id AS version,
    snapshot_time AS committed_at,
    json_extract_string(commit_extra_info, '$.building_id') AS building_id,
    json_extract_string(commit_extra_info, '$.campaign_id') AS campaign_id,
    json_extract_string(commit_extra_info, '$.run_id') AS run_id
FROM ducklake_snapshots('lake')
WHERE commit_extra_info IS NOT NULL
