-- grain: repair of a track after which the defect was there again
-- meaning: the repairs that did not hold, the shortest first: how long until the defect was there again, how often it was repaired, and its size before the repair and since
-- $building_id [campaigns.building_id]: the building; left out, all of them
SELECT
    p.building_id,
    p.track_id,
    p.repair_number,
    p.there_before,
    p.campaign_id AS repaired_campaign,
    p.reopened_campaign,
    round(p.years_until_reopened, 2) AS years_until_reopened,
    t.defect_class,
    round(b.area_m2, 4) AS area_before_m2,
    round(d.area_m2, 4) AS area_reopened_m2,
    round(b.length_m, 3) AS length_before_m,
    round(d.length_m, 3) AS length_reopened_m,
    b.crack_width_mm AS crack_width_before_mm,
    b.crack_width_sigma_mm AS crack_width_before_sigma_mm,
    d.crack_width_mm AS crack_width_reopened_mm,
    d.crack_width_sigma_mm AS crack_width_reopened_sigma_mm,
    p.state_evidence,
    p.reviewer,
    t.track_state AS current_state,
    t.severity,
    t.facade,
    t.storey,
    t.element_name,
    t.element_guid,
    d.best_photo_uri
FROM repairs AS p
JOIN tracks AS t ON t.building_id = p.building_id AND t.track_id = p.track_id
LEFT JOIN track_states AS before
    ON before.building_id = p.building_id
    AND before.track_id = p.track_id
    AND before.campaign_id = p.there_before
LEFT JOIN defects AS b
    ON b.building_id = p.building_id AND b.campaign_id = p.there_before AND b.defect_id = before.defect_id
LEFT JOIN track_states AS again
    ON again.building_id = p.building_id
    AND again.track_id = p.track_id
    AND again.campaign_id = p.reopened_campaign
LEFT JOIN defects AS d
    ON d.building_id = p.building_id AND d.campaign_id = p.reopened_campaign AND d.defect_id = again.defect_id
WHERE p.reopened_campaign IS NOT NULL
  AND ($building_id::VARCHAR IS NULL OR p.building_id = $building_id)
ORDER BY p.building_id, p.years_until_reopened, p.track_id, p.repair_number
