-- {table}: defects | observations | coverage
-- {key}: defect_id | detection_id | facade
-- table: {table}
-- grain: row
-- meaning: the element named by {table} is in elements
SELECT t.{key}, t.element_guid
FROM {table} AS t
LEFT JOIN elements AS e USING (element_guid)
WHERE t.element_guid IS NOT NULL AND e.element_guid IS NULL
