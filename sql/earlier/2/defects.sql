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
    ) AS facade_azimuth_deg
FROM {earlier} AS earlier
