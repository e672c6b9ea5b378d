-- grain: element of a facade
-- meaning: where a crack of a given width could have been missed: the surface that was never imaged, not searched by the detector, imaged too coarsely, or of which that is unknown; the largest first
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
-- $crack_width_mm [number]: the crack's width in millimetres; left out, 0.3
WITH judged AS (
    SELECT
        building_id,
        campaign_id,
        facade,
        storey,
        element_guid,
        area_m2,
        CASE
            WHEN imaged_count = 0 THEN 'never_imaged'
            WHEN searched_count = 0 THEN 'not_searched'
            WHEN found_crack_width_mm IS NULL THEN 'unknown'
            WHEN found_crack_width_mm > coalesce($crack_width_mm::DOUBLE, 0.3) THEN 'too_coarse'
            ELSE 'covered'
        END AS verdict
    FROM coverage
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
      AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
)
SELECT
    j.building_id,
    j.campaign_id,
    j.facade,
    coalesce(j.storey, '(no storey)') AS storey,
    e.ifc_class,
    e.element_name,
    j.element_guid,
    round(sum(j.area_m2), 2) AS surface_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'never_imaged'), 0), 2) AS never_imaged_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'not_searched'), 0), 2) AS not_searched_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'too_coarse'), 0), 2) AS too_coarse_m2,
    round(coalesce(sum(j.area_m2) FILTER (j.verdict = 'unknown'), 0), 2) AS unknown_m2
FROM judged AS j
LEFT JOIN elements AS e USING (building_id, campaign_id, element_guid)
GROUP BY ALL
HAVING bool_or(j.verdict <> 'covered')
ORDER BY building_id, campaign_id, sum(j.area_m2) FILTER (j.verdict <> 'covered') DESC, facade, storey, element_guid
