-- grain: element of a facade
-- meaning: where no campaign would have found a crack of a given width: the surface of the latest campaign's model that was never imaged, never searched by the detector, always imaged too coarsely, or of which that is unknown; the largest first. An element whose GlobalId is new counts from then on
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $crack_width_mm [number]: the crack's width in millimetres; left out, 0.3
WITH measured AS (
    SELECT *, round(facade_azimuth_deg, 2) AS azimuth_deg
    FROM coverage
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
),
current_campaigns AS (
    SELECT building_id, max_by(campaign_id, campaign_number) AS campaign_id
    FROM campaign_order
    WHERE (building_id, campaign_id) IN (SELECT (building_id, campaign_id) FROM measured)
    GROUP BY building_id
),
cells AS (
    SELECT
        building_id,
        facade,
        azimuth_deg,
        cell_column,
        cell_row,
        cell_layer,
        element_guid,
        count(DISTINCT campaign_id) AS campaigns,
        max(imaged_count) AS imaged_count,
        max(searched_count) AS searched_count,
        min(found_crack_width_mm) AS found_crack_width_mm,
        bool_or(searched_count > 0 AND found_crack_width_mm IS NULL) AS partly_unknown
    FROM measured
    GROUP BY building_id, facade, azimuth_deg, cell_column, cell_row, cell_layer, element_guid
),
judged AS (
    SELECT
        m.building_id,
        m.campaign_id,
        m.facade,
        m.storey,
        m.element_guid,
        m.area_m2,
        c.campaigns,
        CASE
            WHEN c.found_crack_width_mm <= coalesce($crack_width_mm::DOUBLE, 0.3) THEN 'covered'
            WHEN c.imaged_count = 0 THEN 'never_imaged'
            WHEN c.searched_count = 0 THEN 'never_searched'
            WHEN c.partly_unknown THEN 'unknown'
            ELSE 'too_coarse'
        END AS verdict
    FROM measured AS m
    JOIN current_campaigns USING (building_id, campaign_id)
    JOIN cells AS c USING (building_id, facade, azimuth_deg, cell_column, cell_row, cell_layer, element_guid)
)
SELECT
    j.building_id,
    j.facade,
    coalesce(j.storey, '(no storey)') AS storey,
    e.ifc_class,
    e.element_name,
    j.element_guid,
    max(j.campaigns) AS campaigns,
    round(sum(j.area_m2), 2) AS surface_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'never_imaged'), 0), 2) AS never_imaged_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'never_searched'), 0), 2) AS never_searched_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'too_coarse'), 0), 2) AS too_coarse_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'unknown'), 0), 2) AS unknown_m2
FROM judged AS j
LEFT JOIN elements AS e USING (building_id, campaign_id, element_guid)
GROUP BY j.building_id, j.facade, j.storey, e.ifc_class, e.element_name, j.element_guid
HAVING bool_or(j.verdict <> 'covered')
ORDER BY j.building_id, sum(j.area_m2) FILTER (j.verdict <> 'covered') DESC, j.facade, storey, j.element_guid
