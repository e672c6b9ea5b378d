-- table: georeference
-- grain: campaign
-- meaning: not more points were used than offered, and the residuals are in order
SELECT control, points_used, points_total, residual_mean_m, residual_rmse_m, residual_max_m
FROM georeference
WHERE points_used > points_total
   OR residual_mean_m > residual_rmse_m + 1e-9
   OR residual_rmse_m > residual_max_m + 1e-9
