-- grain: a file in the photographs' folder
-- meaning: table photos of schema version 3 with the columns of version 4
SELECT
    *,
    NULL::VARCHAR AS utc_offset
FROM {earlier}
