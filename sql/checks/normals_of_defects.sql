-- table: defects
-- grain: row
-- meaning: the surface normals of defects have unit length
SELECT defect_id, normal_x, normal_y, normal_z
FROM defects
WHERE abs(normal_x ** 2 + normal_y ** 2 + normal_z ** 2 - 1) > 1e-6
