-- table: poses
-- grain: pose
-- meaning: a localised photograph's pose has a 6 x 6 covariance, symmetric, with positive variances that agree with its sigmas
SELECT photo_id, pose_source, sigma_east_m, sigma_north_m, sigma_up_m, covariance
FROM poses
WHERE CASE
    WHEN pose_source = 'unlocalised' THEN covariance IS NOT NULL
    ELSE
        covariance IS NULL
        OR len(covariance) <> 36
        OR coalesce(len(list_filter(covariance, lambda value: isfinite(value))), 0) <> 36
        OR len(list_filter(range(1, 7), lambda i: covariance[7 * i - 6] > 0)) <> 6
        OR len(list_filter(
            range(0, 36),
            lambda i: (covariance[i + 1] - covariance[6 * (i % 6) + i // 6 + 1]) ** 2
                > 1e-18 * abs(covariance[7 * (i % 6) + 1] * covariance[7 * (i // 6) + 1])
        )) > 0
        OR coalesce(abs(sigma_east_m ** 2 - covariance[1]) > 1e-6 * covariance[1], true)
        OR coalesce(abs(sigma_north_m ** 2 - covariance[8]) > 1e-6 * covariance[8], true)
        OR coalesce(abs(sigma_up_m ** 2 - covariance[15]) > 1e-6 * covariance[15], true)
END
