-- table: defects
-- grain: row
-- meaning: the geometry of defects is the point of lon_deg, lat_deg and height_ellipsoidal_m, in that order
SELECT defect_id, ST_AsText(ST_GeomFromWKB(geometry)) AS point, lon_deg, lat_deg, height_ellipsoidal_m
FROM defects
WHERE geometry IS NOT NULL
  AND coalesce(
      abs(ST_X(ST_GeomFromWKB(geometry)) - lon_deg) > 1e-9
      OR abs(ST_Y(ST_GeomFromWKB(geometry)) - lat_deg) > 1e-9
      OR abs(ST_Z(ST_GeomFromWKB(geometry)) - height_ellipsoidal_m) > 1e-3,
      true
  )
