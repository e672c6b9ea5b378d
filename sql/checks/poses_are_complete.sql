-- table: poses
-- grain: pose
-- meaning: a localised pose has a centre, a unit quaternion, intrinsics and a point; any other has none, or its prior, and a reason
SELECT photo_id, pose_source, qw, qx, qy, qz, x_site_m, lon_deg, fx_px, reason
FROM poses
WHERE CASE
    WHEN pose_source = 'unlocalised'
        THEN coalesce(x_site_m, lon_deg, qw) IS NOT NULL OR geometry IS NOT NULL OR coalesce(reason, '') = ''
    ELSE
        x_site_m IS NULL OR y_site_m IS NULL OR z_site_m IS NULL
        OR lon_deg IS NULL OR lat_deg IS NULL OR height_ellipsoidal_m IS NULL
        OR fx_px IS NULL OR fy_px IS NULL OR cx_px IS NULL OR cy_px IS NULL
        OR geometry IS NULL
        OR (pose_source = 'prior' AND coalesce(reason, '') = '')
        OR coalesce(abs(qw ** 2 + qx ** 2 + qy ** 2 + qz ** 2 - 1) > 1e-6, true)
END
