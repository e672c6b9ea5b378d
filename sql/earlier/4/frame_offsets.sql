-- grain: a facade in a campaign, or the whole building (facade empty)
-- meaning: table frame_offsets, which schema version 4 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS facade,
    NULL::VARCHAR AS offset_outcome,
    NULL::DOUBLE AS offset_east_m,
    NULL::DOUBLE AS offset_north_m,
    NULL::DOUBLE AS offset_up_m,
    NULL::DOUBLE AS offset_sigma_east_m,
    NULL::DOUBLE AS offset_sigma_north_m,
    NULL::DOUBLE AS offset_sigma_up_m,
    NULL::BIGINT AS offset_count,
    NULL::DOUBLE AS found_again_share,
    NULL::VARCHAR AS detail
WHERE false
