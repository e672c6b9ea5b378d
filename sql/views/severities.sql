-- grain: word of a severity rule pack
-- meaning: the words of each rule pack and their rank, 1 the worst, as data/severity/ lists them
SELECT rules.severity_rule, unnest(rules.words) AS severity, generate_subscripts(rules.words, 1) AS severity_rank
FROM (VALUES
    ('bre251_v1', [
        'very_severe', 'severe', 'moderate', 'slight', 'very_slight', 'negligible', 'not_measured', 'not_covered'
    ]),
    ('concrete_03_v1', ['over_limit', 'within_limit', 'not_measured', 'not_covered']),
    ('extent_v1', ['severe', 'moderate', 'minor']),
    ('nyc_fisp_v1', ['UNSAFE', 'SWARMP', 'SAFE']),
    ('paper_crack_width_v1', ['severe', 'moderate', 'minor', 'not_measured', 'not_covered']),
    ('width_and_extent_v1', ['severe', 'moderate_or_worse', 'moderate', 'minor_or_worse', 'minor'])
) AS rules (severity_rule, words)
