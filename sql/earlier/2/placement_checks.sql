-- grain: a statement about the campaign's place
-- meaning: table placement_checks, which schema version 2 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS statement,
    NULL::VARCHAR AS placement_check_outcome,
    NULL::DOUBLE AS deviation,
    NULL::DOUBLE AS deviation_sigma,
    NULL::DOUBLE AS deviation_limit,
    NULL::VARCHAR AS deviation_unit,
    NULL::VARCHAR AS detail
WHERE false
