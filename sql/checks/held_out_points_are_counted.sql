-- table: georeference
-- grain: campaign
-- meaning: the passport's numbers and residuals of held-out and check points agree with its points
SELECT g.check_points, counted.points, g.check_residual_mean_m, g.check_residual_max_m, counted.largest_m
FROM georeference AS g, (
    SELECT
        count(*) AS points,
        max(sqrt(residual_east_m ** 2 + residual_north_m ** 2 + residual_up_m ** 2)) AS largest_m
    FROM georeference_points
    WHERE point_kind IN ('held_out', 'check')
) AS counted
WHERE g.check_points <> counted.points
   OR coalesce(g.check_residual_mean_m > g.check_residual_max_m + 1e-9, false)
   OR (counted.points = 0) <> (g.check_residual_max_m IS NULL)
   OR coalesce(abs(g.check_residual_max_m - counted.largest_m) > 1e-6, false)
