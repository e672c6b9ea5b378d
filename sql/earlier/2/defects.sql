-- grain: a defect in a campaign
-- meaning: table defects of schema version 2 with the columns of version 3
SELECT
    earlier.*,
    coalesce(
        (
            SELECT max(elements.facade_azimuth_deg)
            FROM lake.elements
            WHERE
                elements.building_id = earlier.building_id
                AND elements.campaign_id = earlier.campaign_id
                AND elements.facade = earlier.facade
        ),
        45.0 * (nullif(list_position(['N', 'NE', 'E', 'SE', 'S', 'SW', 'W', 'NW'], earlier.facade), 0) - 1)
    ) AS facade_azimuth_deg,
    (
        SELECT min(photos.taken_at)
        FROM lake.observations
        JOIN lake.photos USING (building_id, campaign_id, photo_id)
        WHERE
            observations.building_id = earlier.building_id
            AND observations.campaign_id = earlier.campaign_id
            AND observations.defect_id = earlier.defect_id
    ) AS captured_from,
    (
        SELECT max(photos.taken_at)
        FROM lake.observations
        JOIN lake.photos USING (building_id, campaign_id, photo_id)
        WHERE
            observations.building_id = earlier.building_id
            AND observations.campaign_id = earlier.campaign_id
            AND observations.defect_id = earlier.defect_id
    ) AS captured_to,
    (
        SELECT max(campaigns.photographs_uri)
        FROM lake.campaigns
        WHERE campaigns.building_id = earlier.building_id AND campaigns.campaign_id = earlier.campaign_id
    ) || '/' || earlier.best_photo_id AS best_photo_uri
FROM {earlier} AS earlier
