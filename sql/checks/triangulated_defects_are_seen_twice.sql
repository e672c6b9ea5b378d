-- table: defects
-- grain: defect
-- meaning: a triangulated position has two sightings or more, and a deviation its sigma
SELECT defect_id, position_from, sightings, deviation_from_model_m, deviation_sigma_m
FROM defects
WHERE (position_from = 'triangulated' AND sightings < 2)
   OR (deviation_from_model_m IS NOT NULL AND coalesce(deviation_sigma_m, 0) <= 0)
