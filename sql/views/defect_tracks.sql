-- grain: defect that belongs to a track
-- meaning: the track of each defect of a campaign, with its state there; of tracks that share a defect, the one that was not joined into another
SELECT
    building_id,
    campaign_id,
    defect_id,
    track_id,
    track_state
FROM track_states
WHERE defect_id IS NOT NULL
QUALIFY row_number() OVER (
    PARTITION BY building_id, campaign_id, defect_id ORDER BY state_evidence = 'part_of_other', track_id
) = 1
