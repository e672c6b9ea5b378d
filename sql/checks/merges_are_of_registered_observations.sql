-- table: merges
-- grain: pair
-- meaning: a pair is of two registered observations, listed once, each with the defect it belongs to
SELECT m.detection_id, m.other_detection_id, m.defect_id, a.defect_id AS belongs_to, m.other_defect_id,
       b.defect_id AS other_belongs_to, count(*) AS times
FROM merges AS m
LEFT JOIN observations AS a ON a.detection_id = m.detection_id
LEFT JOIN observations AS b ON b.detection_id = m.other_detection_id
GROUP BY ALL
HAVING m.detection_id = m.other_detection_id
    OR coalesce(m.defect_id <> a.defect_id, true)
    OR coalesce(m.other_defect_id <> b.defect_id, true)
    OR count(*) > 1
UNION ALL
SELECT m.detection_id, m.other_detection_id, m.defect_id, NULL, m.other_defect_id, NULL, 2
FROM merges AS m
JOIN merges AS n ON n.detection_id = m.other_detection_id AND n.other_detection_id = m.detection_id
WHERE m.detection_id < m.other_detection_id
