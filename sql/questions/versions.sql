-- grain: commit and campaign
-- meaning: which run, regrading, review or tracking made which version of the lake, by which code, the newest first
-- $building_id [campaigns.building_id]: the building; left out, all of them
SELECT version, committed_at, building_id, campaign_id, content, run_id, code_sha256, regraded_by, reviewed_by
FROM versions
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
ORDER BY version DESC, campaign_id
