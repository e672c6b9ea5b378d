-- The direction of the facade that a defect is on, so that every reader of the table has the same u and v along it.

ALTER TABLE defects ADD COLUMN facade_azimuth_deg DOUBLE;
UPDATE defects SET facade_azimuth_deg = coalesce(
    (
        SELECT max(elements.facade_azimuth_deg)
        FROM elements
        WHERE
            elements.building_id = defects.building_id
            AND elements.campaign_id = defects.campaign_id
            AND elements.facade = defects.facade
    ),
    45.0 * (nullif(list_position(['N', 'NE', 'E', 'SE', 'S', 'SW', 'W', 'NW'], facade), 0) - 1)
);
