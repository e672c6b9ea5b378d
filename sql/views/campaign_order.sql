-- grain: campaign
-- meaning: the campaigns of each building in order of their first photographs; one without capture times by the date that its id begins with
SELECT
    building_id,
    campaign_id,
    captured_from,
    captured_to,
    row_number() OVER in_order AS campaign_number,
    lag(campaign_id) OVER in_order AS campaign_before,
    lead(campaign_id) OVER in_order IS NULL AS is_latest
FROM (
    SELECT
        *,
        regexp_extract(campaign_id, '^(\d{4})(?:\D?(\d{2}))?(?:\D?(\d{2}))?', ['year', 'month', 'day']) AS named
    FROM campaigns
)
WINDOW in_order AS (
    PARTITION BY building_id
    ORDER BY
        coalesce(
            epoch(captured_from),
            epoch(try_strptime(
                concat_ws(
                    '-', named.year, coalesce(nullif(named.month, ''), '01'), coalesce(nullif(named.day, ''), '01')
                ),
                '%Y-%m-%d'
            ))
        ),
        campaign_id
)
