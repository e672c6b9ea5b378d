-- grain: photograph
-- meaning: files that could not be used and photographs without a pose, with the reason
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign; left out, all of them
SELECT
    building_id,
    campaign_id,
    photo_id,
    photo_outcome AS outcome,
    reason
FROM photos
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
  AND photo_outcome <> 'accepted'
UNION ALL
SELECT
    building_id,
    campaign_id,
    photo_id,
    pose_source,
    reason
FROM poses
WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
  AND ($campaign_id::VARCHAR IS NULL OR campaign_id = $campaign_id)
  AND pose_source = 'unlocalised'
ORDER BY building_id, campaign_id, outcome, photo_id
