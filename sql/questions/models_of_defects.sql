-- grain: defect and model
-- meaning: which model, by name and hash, found each defect, in how many photographs, and what reviewers decided
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
-- $defect_id [defects.defect_id]: the defect; left out, all of them
SELECT
    o.building_id,
    o.campaign_id,
    o.defect_id,
    m.track_id,
    o.defect_class,
    d.detector,
    d.detector_sha256,
    count(DISTINCT d.detection_id) AS detections,
    max(d.score) AS best_score,
    count(*) FILTER (r.verdict IN ('confirmed', 'corrected')) AS confirmed,
    count(*) FILTER (r.verdict = 'rejected') AS rejected
FROM observations AS o
JOIN detections AS d USING (building_id, campaign_id, detection_id)
LEFT JOIN defect_tracks AS m
    ON m.building_id = o.building_id AND m.campaign_id = o.campaign_id AND m.defect_id = o.defect_id
LEFT JOIN current_reviews AS r
    ON r.building_id = d.building_id
    AND r.campaign_id = d.campaign_id
    AND r.detection_id = d.detection_id
    AND r.detector_sha256 = d.detector_sha256
    -- another run may have given a detection's name to another box
    AND abs(r.reviewed_box_x_px - d.box_x_px) <= 1
    AND abs(r.reviewed_box_y_px - d.box_y_px) <= 1
    AND abs(r.reviewed_box_width_px - d.box_width_px) <= 1
    AND abs(r.reviewed_box_height_px - d.box_height_px) <= 1
WHERE o.defect_id IS NOT NULL
  AND ($building_id::VARCHAR IS NULL OR o.building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR o.campaign_id = $campaign_id)
  AND ($defect_id::VARCHAR IS NULL OR o.defect_id = $defect_id)
GROUP BY ALL
ORDER BY o.building_id, o.campaign_id, o.defect_id, d.detector
