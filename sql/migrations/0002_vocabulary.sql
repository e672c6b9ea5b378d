-- The field's words for columns and tables, and what the cache holds for each run.

ALTER TABLE runs ADD COLUMN stage_keys VARCHAR;
