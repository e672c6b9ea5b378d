-- {table}: defects | observations
-- {key}: defect_id | detection_id
-- table: {table}
-- grain: row
-- meaning: a covariance is 3 x 3, symmetric and positive, its diagonal the squares of the sigmas
SELECT {key}, sigma_east_m, sigma_north_m, sigma_up_m, covariance_site
FROM {table}
WHERE covariance_site IS NOT NULL
  AND (
      len(covariance_site) <> 9
      OR coalesce(len(list_filter(covariance_site, lambda value: isfinite(value))), 0) <> 9
      OR (covariance_site[2] - covariance_site[4]) ** 2 > 1e-18 * abs(covariance_site[1] * covariance_site[5])
      OR (covariance_site[3] - covariance_site[7]) ** 2 > 1e-18 * abs(covariance_site[1] * covariance_site[9])
      OR (covariance_site[6] - covariance_site[8]) ** 2 > 1e-18 * abs(covariance_site[5] * covariance_site[9])
      -- Sylvester: every leading minor is positive.
      OR covariance_site[1] <= 0
      OR covariance_site[1] * covariance_site[5] - covariance_site[2] ** 2 <= 0
      OR covariance_site[1] * (covariance_site[5] * covariance_site[9] - covariance_site[6] * covariance_site[8])
         - covariance_site[2] * (covariance_site[4] * covariance_site[9] - covariance_site[6] * covariance_site[7])
         + covariance_site[3] * (covariance_site[4] * covariance_site[8] - covariance_site[5] * covariance_site[7])
         <= 0
      OR coalesce(abs(sigma_east_m ** 2 - covariance_site[1]) > 1e-6 * covariance_site[1], true)
      OR coalesce(abs(sigma_north_m ** 2 - covariance_site[5]) > 1e-6 * covariance_site[5], true)
      OR coalesce(abs(sigma_up_m ** 2 - covariance_site[9]) > 1e-6 * covariance_site[9], true)
  )
