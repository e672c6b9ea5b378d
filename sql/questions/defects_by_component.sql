-- grain: IFC class, material and defect class
-- meaning: which kinds of components carry the defects
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    ifc_class,
    coalesce(material, '(unknown)') AS material,
    defect_class,
    count(*) AS defects,
    count(DISTINCT element_guid) AS elements
FROM defects
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
GROUP BY ALL
ORDER BY building_id, campaign_id, defects DESC, ifc_class, material, defect_class
