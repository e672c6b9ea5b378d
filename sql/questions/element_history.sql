-- grain: defect of an element in a campaign
-- meaning: everything on one element: each defect in each campaign with its track, state, size and severity, also where a track's place was only looked at
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $element_guid [elements.element_guid]: the element's GlobalId; left out, all of them
WITH found AS (
    SELECT
        d.building_id,
        d.campaign_id,
        d.element_guid,
        m.track_id,
        d.defect_id,
        d.defect_class,
        d.severity,
        d.width_m,
        d.height_m,
        d.length_m,
        d.area_m2,
        d.crack_width_mm,
        d.crack_width_sigma_mm,
        d.best_photo_uri
    FROM defects AS d
    LEFT JOIN defect_tracks AS m USING (building_id, campaign_id, defect_id)
    WHERE ($building_id::VARCHAR IS NULL OR d.building_id = $building_id)
      AND ($element_guid::VARCHAR IS NULL OR d.element_guid = $element_guid)
    UNION ALL BY NAME
    SELECT s.building_id, s.campaign_id, t.element_guid, s.track_id, s.defect_class
    FROM track_states AS s
    JOIN tracks AS t ON t.building_id = s.building_id AND t.track_id = s.track_id
    WHERE s.defect_id IS NULL
      AND ($building_id::VARCHAR IS NULL OR s.building_id = $building_id)
      AND ($element_guid::VARCHAR IS NULL OR t.element_guid = $element_guid)
)
SELECT
    f.building_id,
    f.element_guid,
    e.ifc_class,
    e.element_name,
    e.material,
    e.facade,
    e.storey,
    f.track_id,
    f.campaign_id,
    o.captured_from,
    s.track_state,
    s.state_evidence,
    f.defect_id,
    f.defect_class,
    f.severity,
    round(f.width_m, 3) AS width_m,
    round(f.height_m, 3) AS height_m,
    round(f.length_m, 3) AS length_m,
    round(f.area_m2, 4) AS area_m2,
    f.crack_width_mm,
    f.crack_width_sigma_mm,
    f.best_photo_uri
FROM found AS f
JOIN campaign_order AS o USING (building_id, campaign_id)
LEFT JOIN track_states AS s
    ON s.building_id = f.building_id AND s.campaign_id = f.campaign_id AND s.track_id = f.track_id
LEFT JOIN elements AS e
    ON e.building_id = f.building_id AND e.campaign_id = f.campaign_id AND e.element_guid = f.element_guid
ORDER BY f.building_id, f.element_guid, f.track_id NULLS LAST, o.campaign_number, f.defect_id
