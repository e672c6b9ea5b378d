-- grain: registered observation
-- meaning: each registered observation with the time and role of its photograph and its distance from the defect's position
SELECT
    o.building_id,
    o.campaign_id,
    o.defect_id,
    o.detection_id,
    o.photo_id,
    p.taken_at,
    p.role,
    o.distance_m,
    o.incidence_deg,
    o.gsd_mm,
    sqrt(
        (o.x_site_m - d.x_site_m) ** 2 + (o.y_site_m - d.y_site_m) ** 2 + (o.z_site_m - d.z_site_m) ** 2
    ) AS from_defect_m
FROM observations AS o
JOIN defects AS d USING (building_id, campaign_id, defect_id)
JOIN photos AS p ON p.building_id = o.building_id AND p.campaign_id = o.campaign_id AND p.photo_id = o.photo_id
