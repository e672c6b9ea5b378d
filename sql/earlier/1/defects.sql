-- grain: a defect in a campaign
-- meaning: table defects of schema version 1 with the columns of version 2
SELECT * RENAME (sightings AS photo_count, position_from AS position_method)
FROM {earlier}
