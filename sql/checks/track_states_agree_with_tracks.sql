-- table: track_states
-- grain: state of a track in a campaign
-- meaning: a state belongs to a track, and a detected one names the defect; the state of the latest campaign is the track's
SELECT s.track_id, s.campaign_id, s.track_state, s.state_evidence, s.defect_id, t.track_state AS current_state
FROM track_states AS s
LEFT JOIN tracks AS t USING (track_id)
WHERE
    t.track_id IS NULL
    OR t.withdrawn
    OR (s.state_evidence = 'detected' AND s.defect_id IS NULL)
    OR (s.campaign_id = t.campaign_id AND s.track_state IS DISTINCT FROM t.track_state)
