-- grain: track in a campaign
-- meaning: everything on one track, campaign by campaign: its state and what it rests on, its size and change with their sigmas, the look at its place, relations to other tracks, photographs
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $track_id [tracks.track_id or number]: the track's id, or its number; left out, all of them
WITH relations AS (
    SELECT
        building_id,
        campaign_id,
        track_id,
        string_agg(concat_ws(' ', track_relation, other_track_id), ', ' ORDER BY track_relation) AS relations
    FROM track_relations
    GROUP BY building_id, campaign_id, track_id
)
SELECT
    s.building_id,
    s.track_id,
    s.campaign_id,
    o.captured_from,
    s.track_state,
    s.state_evidence,
    s.state_remark,
    s.reviewer,
    s.defect_id,
    round(s.match_probability, 3) AS match_probability,
    s.defect_class,
    d.severity,
    round(d.width_m, 3) AS width_m,
    round(d.height_m, 3) AS height_m,
    round(d.length_m, 3) AS length_m,
    round(d.area_m2, 4) AS area_m2,
    d.crack_width_mm,
    d.crack_width_sigma_mm,
    s.previous_campaign,
    round(s.years_since_previous, 2) AS years_since_previous,
    s.changed_quantity,
    round(s.length_change_m, 4) AS length_change_m,
    round(s.length_change_sigma_m, 4) AS length_change_sigma_m,
    round(s.area_change_m2, 4) AS area_change_m2,
    round(s.area_change_sigma_m2, 4) AS area_change_sigma_m2,
    round(s.crack_width_change_mm, 3) AS crack_width_change_mm,
    round(s.crack_width_change_sigma_mm, 3) AS crack_width_change_sigma_mm,
    l.look_verdict,
    l.compared_campaign,
    l.look_count,
    round(l.look_similarity, 2) AS look_similarity,
    r.relations,
    coalesce(d.best_photo_id, l.look_photo_id) AS photo_id,
    d.best_photo_uri,
    l.compared_photo_id
FROM track_states AS s
JOIN campaign_order AS o USING (building_id, campaign_id)
LEFT JOIN defects AS d
    ON d.building_id = s.building_id AND d.campaign_id = s.campaign_id AND d.defect_id = s.defect_id
LEFT JOIN looks AS l
    ON l.building_id = s.building_id AND l.campaign_id = s.campaign_id AND l.track_id = s.track_id
LEFT JOIN relations AS r
    ON r.building_id = s.building_id AND r.campaign_id = s.campaign_id AND r.track_id = s.track_id
WHERE ($building_id::VARCHAR IS NULL OR s.building_id = $building_id)
  AND (
      $track_id::VARCHAR IS NULL
      OR s.track_id = $track_id
      OR ltrim(regexp_extract(s.track_id, '[0-9]+$'), '0') = ltrim($track_id, '0')
  )
ORDER BY s.building_id, s.track_id, o.campaign_number
