-- table: observations
-- grain: observation
-- meaning: an observation that is not registered has a reason
SELECT detection_id, observation_outcome, reason
FROM observations
WHERE observation_outcome <> 'registered' AND coalesce(trim(reason), '') = ''
