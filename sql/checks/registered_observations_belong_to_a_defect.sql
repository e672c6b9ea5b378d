-- table: observations
-- grain: observation
-- meaning: registered observations and no others belong to a defect, which exists and has their class
SELECT o.detection_id, o.observation_outcome, o.defect_id, o.defect_class, d.defect_class AS class_of_defect
FROM observations AS o
LEFT JOIN defects AS d USING (defect_id)
WHERE CASE
    WHEN o.observation_outcome = 'registered' THEN d.defect_id IS NULL OR d.defect_class <> o.defect_class
    ELSE o.defect_id IS NOT NULL
END
