-- table: observations
-- grain: row
-- meaning: the surface normals of observations have unit length
SELECT detection_id, normal_x, normal_y, normal_z
FROM observations
WHERE abs(normal_x ** 2 + normal_y ** 2 + normal_z ** 2 - 1) > 1e-6
