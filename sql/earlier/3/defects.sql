-- grain: a defect in a campaign
-- meaning: table defects of schema version 3 with the columns of version 4
SELECT
    *,
    NULL::VARCHAR AS severity_low,
    NULL::VARCHAR AS severity_high,
    NULL::DOUBLE AS crack_width_blur_mm
FROM {earlier}
