-- table: georeference
-- grain: campaign
-- meaning: no more points were used than given, and the mean residual does not exceed the maximum
SELECT control, points_used, points_total, residual_mean_m, residual_rmse_m, residual_max_m
FROM georeference
WHERE points_used > points_total
   OR residual_mean_m > residual_rmse_m + 1e-9
   OR residual_rmse_m > residual_max_m + 1e-9
