-- grain: track
-- meaning: the defects of a building for life, with their current state, what matters most first: place, size, change since the detection before with its sigma, when they were first and last seen; without those that are withdrawn
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $states [tracks.track_state, ...]: only those in these states, such as new,grown; left out, all of them
-- $defect_class [tracks.defect_class]: only crack, spalling or moisture; left out, all of them
SELECT
    t.building_id,
    t.track_id,
    t.defect_class,
    t.track_state,
    s.state_evidence,
    t.severity,
    t.facade,
    t.storey,
    t.element_name,
    t.ifc_class,
    round(t.width_m, 3) AS width_m,
    round(t.height_m, 3) AS height_m,
    round(t.length_m, 3) AS length_m,
    round(t.area_m2, 4) AS area_m2,
    t.crack_width_mm,
    s.changed_quantity,
    CASE s.changed_quantity
        WHEN 'length_m' THEN s.length_change_m
        WHEN 'area_m2' THEN s.area_change_m2
        WHEN 'crack_width_mm' THEN s.crack_width_change_mm
    END AS change,
    CASE s.changed_quantity
        WHEN 'length_m' THEN s.length_change_sigma_m
        WHEN 'area_m2' THEN s.area_change_sigma_m2
        WHEN 'crack_width_mm' THEN s.crack_width_change_sigma_mm
    END AS change_sigma,
    s.previous_campaign,
    s.years_since_previous,
    t.first_campaign,
    t.first_seen_at,
    f.track_state AS first_state,
    t.last_campaign,
    t.last_seen_at,
    t.detected_count,
    t.campaign_id,
    t.detected_campaign,
    t.defect_id
FROM tracks AS t
LEFT JOIN track_states AS s
    ON s.building_id = t.building_id AND s.campaign_id = t.campaign_id AND s.track_id = t.track_id
LEFT JOIN track_states AS f
    ON f.building_id = t.building_id AND f.campaign_id = t.first_campaign AND f.track_id = t.track_id
LEFT JOIN severities AS r ON r.severity_rule = t.severity_rule AND r.severity = t.severity
WHERE NOT t.withdrawn
  AND ($building_id::VARCHAR IS NULL OR t.building_id = $building_id)
  AND ($states::VARCHAR IS NULL OR list_contains(string_split(replace($states, ' ', ''), ','), t.track_state))
  AND ($defect_class::VARCHAR IS NULL OR t.defect_class = $defect_class)
ORDER BY
    t.building_id,
    list_position(
        ['grown', 'reopened', 'new', 'first_seen', 'repaired', 'not_found', 'not_imaged', 'shrunk', 'seen'],
        t.track_state
    ),
    coalesce(r.severity_rank, 99),
    greatest(t.width_m, t.height_m) DESC,
    t.track_id
