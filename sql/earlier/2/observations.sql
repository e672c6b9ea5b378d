-- grain: an accepted detection
-- meaning: table observations of schema version 2 with the columns of version 3
SELECT
    earlier.*,
    (
        SELECT max(photos.taken_at)
        FROM lake.photos
        WHERE
            photos.building_id = earlier.building_id
            AND photos.campaign_id = earlier.campaign_id
            AND photos.photo_id = earlier.photo_id
    ) AS captured_at
FROM {earlier} AS earlier
