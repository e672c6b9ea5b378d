-- {table}: defects | observations
-- {key}: defect_id | detection_id
-- {allowed_m}: 0.1 + spread_m + coalesce(abs(deviation_from_model_m), 0) | 0.02
-- table: {table}
-- grain: row
-- meaning: a patch is a polygon in 3D around the position in its row, within its spread and its deviation from the model
SELECT {key}, lon_deg, lat_deg, height_ellipsoidal_m, patch_size_m, gap_m
FROM (
    SELECT
        *,
        sqrt(
            ((lon_high - lon_low) * east_m) ** 2 + ((lat_high - lat_low) * north_m) ** 2 + (up_high - up_low) ** 2
        ) AS patch_size_m,
        sqrt(
            (greatest(lon_low - lon_deg, lon_deg - lon_high, 0) * east_m) ** 2
            + (greatest(lat_low - lat_deg, lat_deg - lat_high, 0) * north_m) ** 2
            + greatest(up_low - height_ellipsoidal_m, height_ellipsoidal_m - up_high, 0) ** 2
        ) AS gap_m
    FROM (
        SELECT
            {key}, lon_deg, lat_deg, height_ellipsoidal_m, {allowed_m} AS allowed_m,
            -- Metres in a degree, to 1 %: this judges distances of centimetres.
            111320 * cos(radians(lat_deg)) AS east_m, 111320 AS north_m,
            ST_GeometryType(shape) AS kind, ST_NPoints(shape) AS corners,
            ST_XMin(shape) AS lon_low, ST_XMax(shape) AS lon_high,
            ST_YMin(shape) AS lat_low, ST_YMax(shape) AS lat_high,
            ST_ZMin(shape) AS up_low, ST_ZMax(shape) AS up_high
        FROM (SELECT *, ST_GeomFromWKB(patch) AS shape FROM {table} WHERE patch IS NOT NULL)
    )
)
WHERE kind NOT IN ('POLYGON', 'MULTIPOLYGON')
   OR corners < 4
   OR coalesce(gap_m > patch_size_m / 4 + allowed_m, true)
