-- grain: a run
-- meaning: table runs of schema version 1 with the columns of version 2
SELECT *, NULL::VARCHAR AS stage_keys
FROM {earlier}
