-- grain: a look at the place of a track in a campaign that did not detect it
-- meaning: table looks, which schema version 4 does not have, without rows
SELECT
    NULL::VARCHAR AS building_id,
    NULL::VARCHAR AS campaign_id,
    NULL::VARCHAR AS run_id,
    NULL::VARCHAR AS track_id,
    NULL::VARCHAR AS compared_campaign,
    NULL::VARCHAR AS defect_id,
    NULL::VARCHAR AS look_verdict,
    NULL::BIGINT AS look_count,
    NULL::BIGINT AS compared_count,
    NULL::VARCHAR AS look_photo_id,
    NULL::VARCHAR AS compared_photo_id,
    NULL::DOUBLE AS look_similarity,
    NULL::DOUBLE AS surroundings_similarity,
    NULL::DOUBLE AS fading_extent,
    NULL::DOUBLE AS fading_sigmas,
    NULL::DOUBLE AS darkening_extent,
    NULL::DOUBLE AS contrast_difference,
    NULL::DOUBLE AS contrast_left,
    NULL::DOUBLE AS look_cell_mm
WHERE false
