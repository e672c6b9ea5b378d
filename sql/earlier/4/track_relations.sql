-- grain: a relation of a track in a campaign
-- meaning: table track_relations, which schema version 4 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS track_id,
    NULL::VARCHAR AS track_relation,
    NULL::VARCHAR AS other_track_id,
    NULL::VARCHAR AS detail
WHERE false
