-- table: observations
-- grain: row
-- meaning: the element named by observations is in elements
SELECT t.detection_id, t.element_guid
FROM observations AS t
LEFT JOIN elements AS e USING (element_guid)
WHERE t.element_guid IS NOT NULL AND e.element_guid IS NULL
