-- grain: facade, storey, material or element class
-- meaning: defects per square metre that the detector searched, by facade, storey, material and element class, so that a part that was photographed more does not seem worse; parts that were not searched have no density. The sigma is that of counting (Poisson)
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
WITH cells AS (
    SELECT c.*, e.material, e.ifc_class
    FROM coverage AS c
    LEFT JOIN elements AS e USING (building_id, campaign_id, element_guid)
    WHERE ($building_id::VARCHAR IS NULL OR c.building_id = $building_id)
      AND ($campaign_id::VARCHAR IS NULL OR c.campaign_id = $campaign_id)
),
areas AS (
    SELECT
        building_id,
        campaign_id,
        unnest(['facade', 'storey', 'material', 'ifc_class']) AS divided_by,
        unnest([facade, storey, material, ifc_class]) AS part,
        area_m2,
        imaged_count,
        searched_count
    FROM cells
),
surfaces AS (
    SELECT
        building_id,
        campaign_id,
        divided_by,
        coalesce(part, '(unknown)') AS part,
        sum(area_m2) AS surface_m2,
        coalesce(sum(area_m2) FILTER (imaged_count > 0), 0) AS imaged_m2,
        coalesce(sum(area_m2) FILTER (searched_count > 0), 0) AS searched_m2
    FROM areas
    GROUP BY ALL
),
places AS (
    SELECT
        building_id,
        campaign_id,
        unnest(['facade', 'storey', 'material', 'ifc_class']) AS divided_by,
        unnest([facade, storey, material, ifc_class]) AS part,
        defect_class
    FROM defects
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
      AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
),
counts AS (
    SELECT
        building_id,
        campaign_id,
        divided_by,
        coalesce(part, '(unknown)') AS part,
        count(*) AS defects,
        count(*) FILTER (defect_class = 'crack') AS cracks,
        count(*) FILTER (defect_class = 'spalling') AS spallings,
        count(*) FILTER (defect_class = 'moisture') AS moistures
    FROM places
    GROUP BY ALL
)
SELECT
    building_id,
    campaign_id,
    divided_by,
    part,
    coalesce(defects, 0) AS defects,
    coalesce(cracks, 0) AS cracks,
    coalesce(spallings, 0) AS spallings,
    coalesce(moistures, 0) AS moistures,
    round(surface_m2, 2) AS surface_m2,
    round(imaged_m2, 2) AS imaged_m2,
    round(searched_m2, 2) AS searched_m2,
    CASE WHEN searched_m2 > 0 THEN round(coalesce(defects, 0) / searched_m2, 4) END AS defects_per_m2,
    CASE
        WHEN searched_m2 > 0 THEN round(sqrt(greatest(coalesce(defects, 0), 1)) / searched_m2, 4)
    END AS defects_per_m2_sigma
FROM surfaces
FULL JOIN counts USING (building_id, campaign_id, divided_by, part)
ORDER BY building_id, campaign_id, divided_by, defects_per_m2 DESC NULLS LAST, part
