-- grain: a review of a track in a campaign
-- meaning: table track_reviews, which schema version 4 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS review_id,
    NULL::VARCHAR AS track_id,
    NULL::VARCHAR AS track_state,
    NULL::VARCHAR AS reviewer,
    NULL::TIMESTAMPTZ AS reviewed_at,
    NULL::VARCHAR AS note
WHERE false
