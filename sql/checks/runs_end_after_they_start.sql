-- table: runs
-- grain: run
-- meaning: a run does not end before it starts
SELECT started_at, finished_at FROM runs WHERE finished_at < started_at
