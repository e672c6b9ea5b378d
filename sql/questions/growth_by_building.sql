-- grain: building
-- meaning: the portfolio by growth: significant growths per year in which a defect was watched, so that buildings with more defects or more campaigns do not rank first for that; with the numbers and shares grown, new and reopened per year. Sigmas are those of counting (Poisson; of a share, binomial). New are those whose place was imaged before without them; a building without a history has no numbers
-- $building_id [campaigns.building_id]: the building; left out, all of them
WITH periods AS (
    SELECT
        building_id,
        count(*) AS campaigns,
        min(captured_from) AS captured_from,
        max(captured_from) AS captured_to,
        (epoch(max(captured_from)) - epoch(min(captured_from))) / (365.25 * 86400) AS years
    FROM campaign_order
    WHERE ($building_id::VARCHAR IS NULL OR building_id = $building_id)
    GROUP BY building_id
),
counts AS (
    SELECT
        building_id,
        count(DISTINCT track_id) AS tracks,
        count(DISTINCT track_id) FILTER (previous_campaign IS NOT NULL) AS compared,
        count(DISTINCT track_id) FILTER (track_state = 'grown') AS grown,
        count(*) FILTER (track_state = 'grown') AS growths,
        count(*) FILTER (track_state = 'new') AS new,
        count(*) FILTER (track_state = 'reopened') AS reopened,
        sum(years_since_previous) FILTER (defect_id IS NOT NULL) AS watched_years
    FROM track_states
    GROUP BY building_id
)
SELECT
    p.building_id,
    p.campaigns,
    p.captured_from,
    p.captured_to,
    round(p.years, 2) AS years,
    c.tracks,
    c.compared,
    c.grown,
    round(c.grown / nullif(c.compared, 0), 3) AS grown_share,
    round(
        sqrt(c.grown / nullif(c.compared, 0) * (1 - c.grown / nullif(c.compared, 0)) / nullif(c.compared, 0)), 3
    ) AS grown_share_sigma,
    round(c.growths / nullif(c.watched_years, 0), 4) AS growths_per_defect_year,
    round(sqrt(greatest(c.growths, 1)) / nullif(c.watched_years, 0), 4) AS growths_per_defect_year_sigma,
    round(c.growths / nullif(p.years, 0), 2) AS growths_per_year,
    round(sqrt(greatest(c.growths, 1)) / nullif(p.years, 0), 2) AS growths_per_year_sigma,
    c.new,
    round(c.new / nullif(p.years, 0), 2) AS new_per_year,
    round(sqrt(greatest(c.new, 1)) / nullif(p.years, 0), 2) AS new_per_year_sigma,
    c.reopened,
    round(c.reopened / nullif(p.years, 0), 2) AS reopened_per_year,
    round(sqrt(greatest(c.reopened, 1)) / nullif(p.years, 0), 2) AS reopened_per_year_sigma
FROM periods AS p
LEFT JOIN counts AS c USING (building_id)
ORDER BY growths_per_defect_year DESC NULLS LAST, p.building_id
