-- grain: a campaign
-- meaning: table georeference of schema version 1 with the columns of version 2
SELECT * RENAME (
    tie_inflation AS tie_variance_factor,
    shift_score AS edge_score,
    competing_score AS edge_score_runner_up
)
FROM {earlier}
