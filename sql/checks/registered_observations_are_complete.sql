-- table: observations
-- grain: observation
-- meaning: a registered observation has its position, size, element and point
SELECT detection_id, x_site_m, lon_deg, east_map_m, normal_x, incidence_deg, width_m, element_guid
FROM observations
WHERE observation_outcome = 'registered'
  AND (
      x_site_m IS NULL OR y_site_m IS NULL OR z_site_m IS NULL
      OR lon_deg IS NULL OR lat_deg IS NULL OR height_ellipsoidal_m IS NULL
      OR east_map_m IS NULL OR north_map_m IS NULL OR height_map_m IS NULL
      OR normal_x IS NULL OR normal_y IS NULL OR normal_z IS NULL
      OR incidence_deg IS NULL OR distance_m IS NULL OR gsd_mm IS NULL
      OR width_m IS NULL OR height_m IS NULL OR area_m2 IS NULL
      OR element_guid IS NULL OR facade IS NULL OR geometry IS NULL
  )
