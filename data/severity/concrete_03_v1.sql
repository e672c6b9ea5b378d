-- grain: defect
-- meaning: cracks in reinforced concrete, wider than 0.3 mm or not
-- severities: over_limit, within_limit, not_measured, not_covered
--
-- 0.3 mm is the width that EN 1992-1-1 (7.3.1, Table 7.1N) recommends as the limit for reinforced members outdoors
-- (exposure XC2 to XC4, XD, XS). It is a limit of *calculated* widths at design, and national annexes differ; for a
-- crack found on a wall it is the usual threshold above which the steel's cover is looked at.
-- Concrete is told by the element's material (concrete, Beton, RC; no blocks or masonry). An element without a material
-- is taken for concrete, since whoever chooses this pack has a concrete building; another material is not_covered, and
-- so are other classes than crack. A crack that is narrower than the photographs can tell (below_limit) is within_limit
-- where that limit is 0.3 mm or less; with a wider one, or of which nothing is known, it is not_measured.
SELECT
    defect_id,
    CASE
        WHEN defect_class <> 'crack' THEN 'not_covered'
        WHEN material IS NOT NULL
             AND NOT (regexp_matches(material, '(?i)concrete|beton|\bRC\b')
                      AND NOT regexp_matches(material, '(?i)block|masonry|mauer|stein'))
            THEN 'not_covered'
        WHEN crack_width_mm > 0.3 THEN 'over_limit'
        WHEN crack_width_mm IS NOT NULL THEN 'within_limit'
        WHEN crack_width_outcome = 'below_limit' AND crack_width_limit_mm <= 0.3 THEN 'within_limit'
        ELSE 'not_measured'
    END AS severity
FROM defects
