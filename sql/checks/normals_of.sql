-- {table}: defects | observations | coverage
-- {key}: defect_id | detection_id | facade
-- table: {table}
-- grain: row
-- meaning: the surface normals of {table} have unit length
SELECT {key}, normal_x, normal_y, normal_z
FROM {table}
WHERE abs(normal_x ** 2 + normal_y ** 2 + normal_z ** 2 - 1) > 1e-6
