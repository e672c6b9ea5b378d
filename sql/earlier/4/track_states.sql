-- grain: a track in a campaign
-- meaning: table track_states, which schema version 4 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS track_id,
    NULL::VARCHAR AS track_state,
    NULL::VARCHAR AS state_evidence,
    NULL::VARCHAR AS defect_id,
    NULL::VARCHAR AS defect_class,
    NULL::VARCHAR AS state_remark,
    NULL::DOUBLE AS match_probability,
    NULL::VARCHAR AS previous_campaign,
    NULL::DOUBLE AS years_since_previous,
    NULL::DOUBLE AS length_change_m,
    NULL::DOUBLE AS length_change_sigma_m,
    NULL::DOUBLE AS area_change_m2,
    NULL::DOUBLE AS area_change_sigma_m2,
    NULL::DOUBLE AS crack_width_change_mm,
    NULL::DOUBLE AS crack_width_change_sigma_mm,
    NULL::VARCHAR AS changed_quantity,
    NULL::VARCHAR AS reviewer,
    NULL::GEOMETRY AS geometry
WHERE false
