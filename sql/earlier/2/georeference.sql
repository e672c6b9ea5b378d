-- grain: a campaign
-- meaning: table georeference of schema version 2 with the columns of version 3
SELECT
    *,
    CAST(NULL AS VARCHAR) AS crs_operation,
    CAST(NULL AS DOUBLE) AS crs_operation_accuracy_m,
    CAST(NULL AS VARCHAR) AS control_operation,
    CAST(NULL AS DOUBLE) AS control_operation_accuracy_m,
    CAST(NULL AS DOUBLE) AS control_operation_sigma_m
FROM {earlier}
