-- grain: growth of a track since the campaign that detected it before
-- meaning: the defects that grew significantly, the fastest first, in per cent of their size before a year (of an area half of that, as of its sides), because lengths, areas and widths have different units; with one sigma of the change. The change is without what all sizes of a campaign share, so that it need not be the difference of both sizes
-- $building_id [campaigns.building_id]: the building; left out, all of them
-- $campaign_id [campaigns.campaign_id]: the campaign that found them grown; left out, all of them
-- $quantity [track_states.changed_quantity]: only the growth of length_m, area_m2 or crack_width_mm; left out, all of them
-- $limit [number]: rows at most; left out, 50
WITH grown AS (
    SELECT
        s.*,
        CASE s.changed_quantity
            WHEN 'length_m' THEN s.length_change_m
            WHEN 'area_m2' THEN s.area_change_m2
            WHEN 'crack_width_mm' THEN s.crack_width_change_mm
        END AS change,
        CASE s.changed_quantity
            WHEN 'length_m' THEN s.length_change_sigma_m
            WHEN 'area_m2' THEN s.area_change_sigma_m2
            WHEN 'crack_width_mm' THEN s.crack_width_change_sigma_mm
        END AS change_sigma,
        CASE s.changed_quantity
            WHEN 'length_m' THEN d.length_m
            WHEN 'area_m2' THEN d.area_m2
            WHEN 'crack_width_mm' THEN d.crack_width_mm
        END AS size,
        CASE s.changed_quantity
            WHEN 'length_m' THEN b.length_m
            WHEN 'area_m2' THEN b.area_m2
            WHEN 'crack_width_mm' THEN b.crack_width_mm
        END AS size_before,
        d.best_photo_uri
    FROM track_states AS s
    LEFT JOIN defects AS d
        ON d.building_id = s.building_id AND d.campaign_id = s.campaign_id AND d.defect_id = s.defect_id
    LEFT JOIN track_states AS p
        ON p.building_id = s.building_id AND p.campaign_id = s.previous_campaign AND p.track_id = s.track_id
    LEFT JOIN defects AS b
        ON b.building_id = p.building_id AND b.campaign_id = p.campaign_id AND b.defect_id = p.defect_id
    WHERE s.track_state = 'grown'
      AND ($building_id::VARCHAR IS NULL OR s.building_id = $building_id)
      AND ($campaign_id::VARCHAR IS NULL OR s.campaign_id = $campaign_id)
      AND ($quantity::VARCHAR IS NULL OR s.changed_quantity = $quantity)
),
rated AS (
    SELECT
        *,
        change / nullif(years_since_previous, 0) AS per_year,
        change_sigma / nullif(years_since_previous, 0) AS per_year_sigma
    FROM grown
)
SELECT
    g.building_id,
    g.campaign_id,
    g.track_id,
    g.defect_class,
    t.severity,
    t.track_state AS current_state,
    g.changed_quantity,
    round(g.size_before, 4) AS size_before,
    round(g.size, 4) AS size,
    round(g.change, 4) AS change,
    round(g.change_sigma, 4) AS change_sigma,
    g.previous_campaign,
    round(g.years_since_previous, 2) AS years,
    round(g.per_year, 4) AS per_year,
    round(g.per_year_sigma, 4) AS per_year_sigma,
    round(100 * g.per_year / g.size_before, 1) AS percent_per_year,
    round(100 * g.per_year_sigma / g.size_before, 1) AS percent_per_year_sigma,
    t.trend_quantity,
    round(t.trend_per_year, 4) AS trend_per_year,
    round(t.trend_low_per_year, 4) AS trend_low_per_year,
    round(t.trend_high_per_year, 4) AS trend_high_per_year,
    t.next_severity,
    t.next_limit_at,
    t.trend_remark,
    t.facade,
    t.storey,
    t.element_name,
    g.state_evidence,
    g.reviewer,
    g.best_photo_uri
FROM rated AS g
JOIN tracks AS t ON t.building_id = g.building_id AND t.track_id = g.track_id
ORDER BY
    g.per_year / g.size_before * CASE WHEN g.changed_quantity = 'area_m2' THEN 0.5 ELSE 1 END DESC NULLS LAST,
    g.building_id,
    g.track_id,
    g.campaign_id
LIMIT coalesce($limit::BIGINT, 50)
