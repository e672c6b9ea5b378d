-- grain: a pair of neighbouring observations
-- meaning: table merges of schema version 1 with the columns of version 2
SELECT * RENAME (apart_m AS separation_m, apart_sigma AS mahalanobis_distance)
FROM {earlier}
