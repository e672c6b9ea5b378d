-- The direction of the facade that a defect is on, so that every reader of the table has the same u and v along it;
-- lens and zoom of photographs; when the photographs of observations and defects were taken, and where the best one is.

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

ALTER TABLE photos ADD COLUMN image_source VARCHAR;
ALTER TABLE photos ADD COLUMN digital_zoom DOUBLE;
ALTER TABLE photos ADD COLUMN exif_focal_length_35mm_mm DOUBLE;
ALTER TABLE observations ADD COLUMN captured_at TIMESTAMP WITH TIME ZONE;
UPDATE observations SET captured_at = (
    SELECT max(photos.taken_at)
    FROM photos
    WHERE
        photos.building_id = observations.building_id
        AND photos.campaign_id = observations.campaign_id
        AND photos.photo_id = observations.photo_id
);
ALTER TABLE defects ADD COLUMN captured_from TIMESTAMP WITH TIME ZONE;
ALTER TABLE defects ADD COLUMN captured_to TIMESTAMP WITH TIME ZONE;
ALTER TABLE defects ADD COLUMN best_photo_uri VARCHAR;
UPDATE defects SET
    captured_from = (
        SELECT min(observations.captured_at)
        FROM observations
        WHERE
            observations.building_id = defects.building_id
            AND observations.campaign_id = defects.campaign_id
            AND observations.defect_id = defects.defect_id
    ),
    captured_to = (
        SELECT max(observations.captured_at)
        FROM observations
        WHERE
            observations.building_id = defects.building_id
            AND observations.campaign_id = defects.campaign_id
            AND observations.defect_id = defects.defect_id
    ),
    best_photo_uri = (
        SELECT max(campaigns.photographs_uri)
        FROM campaigns
        WHERE campaigns.building_id = defects.building_id AND campaigns.campaign_id = defects.campaign_id
    ) || '/' || best_photo_id;
-- Coordinate operations of the published longitudes and of the control, with their accuracy.

ALTER TABLE georeference ADD COLUMN crs_operation VARCHAR;
ALTER TABLE georeference ADD COLUMN crs_operation_accuracy_m DOUBLE;
ALTER TABLE georeference ADD COLUMN control_operation VARCHAR;
ALTER TABLE georeference ADD COLUMN control_operation_accuracy_m DOUBLE;
ALTER TABLE georeference ADD COLUMN control_operation_sigma_m DOUBLE;

-- How EXIF turns a photograph.
ALTER TABLE photos ADD COLUMN exif_orientation BIGINT;

-- placement_checks: one row per statement about the campaign's place
CREATE TABLE placement_checks (
    building_id             VARCHAR NOT NULL,
    campaign_id             VARCHAR NOT NULL,
    run_id                  VARCHAR NOT NULL,
    statement               VARCHAR NOT NULL,
    placement_check_outcome VARCHAR NOT NULL,
    deviation               DOUBLE,
    deviation_sigma         DOUBLE,
    deviation_limit         DOUBLE,
    deviation_unit          VARCHAR NOT NULL,
    detail                  VARCHAR NOT NULL
);
