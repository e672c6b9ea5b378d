-- grain: subject
-- meaning: the last word on each place that was reviewed; earlier ones stay in reviews
SELECT *
FROM reviews
QUALIFY row_number() OVER (
    PARTITION BY building_id, campaign_id, subject ORDER BY reviewed_at DESC, review_id DESC
) = 1
