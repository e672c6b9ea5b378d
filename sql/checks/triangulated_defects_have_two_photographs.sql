-- table: defects
-- grain: defect
-- meaning: a defect of triangulated position is seen in two photographs or more, and a deviation has its sigma
SELECT defect_id, position_method, photo_count, deviation_from_model_m, deviation_sigma_m
FROM defects
WHERE (position_method = 'triangulated' AND photo_count < 2)
   OR (deviation_from_model_m IS NOT NULL AND coalesce(deviation_sigma_m, 0) <= 0)
