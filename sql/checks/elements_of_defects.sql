-- table: defects
-- grain: row
-- meaning: the element named by defects is in elements
SELECT t.defect_id, t.element_guid
FROM defects AS t
LEFT JOIN elements AS e USING (element_guid)
WHERE t.element_guid IS NOT NULL AND e.element_guid IS NULL
