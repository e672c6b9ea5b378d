-- table: photos
-- grain: photograph
-- meaning: a photograph that is not accepted has a reason, an accepted one has its size and role
SELECT photo_id, photo_outcome, reason, image_width_px, image_height_px, role
FROM photos
WHERE CASE
    WHEN photo_outcome = 'accepted' THEN image_width_px IS NULL OR image_height_px IS NULL OR role IS NULL
    ELSE coalesce(reason, '') = ''
END
