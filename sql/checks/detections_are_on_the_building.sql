-- table: observations
-- grain: campaign
-- meaning: of ten detections or more in localised photographs, at least one in twenty is on the building
SELECT count(*) AS localised, count(*) FILTER (observation_outcome = 'registered') AS registered
FROM observations
WHERE observation_outcome NOT IN ('unlocalised', 'masked', 'outside')
HAVING count(*) >= 10 AND count(*) FILTER (observation_outcome = 'registered') < 0.05 * count(*)
