-- table: merges
-- grain: pair
-- meaning: joined pairs are of one defect; pairs kept apart are of two, unless further pairs join them
WITH joined AS (
    SELECT detection_id AS one FROM merges WHERE merge_decision = 'joined'
    UNION
    SELECT other_detection_id FROM merges WHERE merge_decision = 'joined'
)
SELECT m.detection_id, m.other_detection_id, m.merge_decision, m.merge_reason, m.defect_id, m.other_defect_id
FROM merges AS m
WHERE CASE
    WHEN m.merge_decision = 'joined' THEN m.defect_id <> m.other_defect_id
    ELSE m.defect_id = m.other_defect_id
         AND (m.detection_id NOT IN (SELECT one FROM joined) OR m.other_detection_id NOT IN (SELECT one FROM joined))
END
