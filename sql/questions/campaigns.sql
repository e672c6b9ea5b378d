-- grain: campaign
-- meaning: what is in the lake: each campaign with its counts, its control and the version that holds it
-- $building_id [campaigns.building_id]: the building; left out, all of them
SELECT
    c.building_id,
    c.campaign_id,
    c.captured_from,
    c.photos_total,
    c.photos_localised,
    c.detections_total,
    c.defects_total,
    g.control,
    g.residual_rmse_m,
    r.run_id,
    r.finished_at,
    v.version
FROM campaigns AS c
JOIN campaign_order AS o USING (building_id, campaign_id)
JOIN georeference AS g USING (building_id, campaign_id)
JOIN runs AS r USING (building_id, campaign_id)
LEFT JOIN (
    SELECT building_id, campaign_id, max(version) AS version FROM versions GROUP BY building_id, campaign_id
) AS v USING (building_id, campaign_id)
WHERE ($building_id::VARCHAR IS NULL OR c.building_id = $building_id)
ORDER BY c.building_id, o.campaign_number
