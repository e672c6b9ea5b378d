-- table: track_states
-- grain: defect
-- meaning: every defect is a sighting of one track, unless the campaign's frame was refused
SELECT d.defect_id, count(s.track_id) AS tracks
FROM defects AS d
LEFT JOIN track_states AS s USING (defect_id)
WHERE
    NOT EXISTS (SELECT 1 FROM frame_offsets AS f WHERE f.offset_outcome = 'refused')
GROUP BY d.defect_id
HAVING count(s.track_id) <> 1
