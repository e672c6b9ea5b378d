-- grain: a file in the photographs' folder
-- meaning: table photos of schema version 2 with the columns of version 3
SELECT
    *,
    NULL::VARCHAR AS image_source,
    NULL::DOUBLE AS digital_zoom,
    NULL::DOUBLE AS exif_focal_length_35mm_mm,
    NULL::BIGINT AS exif_orientation
FROM {earlier}
