-- grain: a known defect and defect of a campaign that may be the same
-- meaning: table track_candidates, which schema version 4 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS track_id,
    NULL::VARCHAR AS defect_id,
    NULL::DOUBLE AS displacement_m,
    NULL::DOUBLE AS mahalanobis_distance,
    NULL::DOUBLE AS log_odds,
    NULL::DOUBLE AS match_probability,
    NULL::BOOLEAN AS matched
WHERE false
