-- {table}: defects | poses
-- {key}: defect_id | photo_id
-- table: {table}
-- grain: row
-- meaning: the geometry of {table} is the point of lon_deg, lat_deg and height_ellipsoidal_m, in that order
SELECT {key}, ST_AsText(ST_GeomFromWKB(geometry)) AS point, lon_deg, lat_deg, height_ellipsoidal_m
FROM {table}
WHERE geometry IS NOT NULL
  AND coalesce(
      abs(ST_X(ST_GeomFromWKB(geometry)) - lon_deg) > 1e-9
      OR abs(ST_Y(ST_GeomFromWKB(geometry)) - lat_deg) > 1e-9
      OR abs(ST_Z(ST_GeomFromWKB(geometry)) - height_ellipsoidal_m) > 1e-3,
      true
  )
