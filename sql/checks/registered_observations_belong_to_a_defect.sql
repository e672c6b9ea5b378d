-- table: observations
-- grain: observation
-- meaning: only registered observations belong to a defect; it exists and has their class, or the class of the majority
SELECT o.detection_id, o.observation_outcome, o.defect_id, o.defect_class, d.defect_class AS class_of_defect
FROM observations AS o
LEFT JOIN defects AS d USING (defect_id)
LEFT JOIN (
    SELECT detection_id FROM merges WHERE merge_reason = 'outvoted'
    UNION
    SELECT other_detection_id FROM merges WHERE merge_reason = 'outvoted'
) AS v USING (detection_id)
WHERE CASE
    WHEN o.observation_outcome = 'registered'
        THEN d.defect_id IS NULL OR (d.defect_class <> o.defect_class AND v.detection_id IS NULL)
    ELSE o.defect_id IS NOT NULL
END
