-- grain: defect
-- meaning: severity by class and largest extent; a first sorting for a person, never a grade
-- severities: severe, moderate, minor
--
-- A crack's width is often narrower than the photographs can tell, so the paper's limits (0.2 mm, 0.5 mm) and those of
-- BRE 251 are left to the packs that grade by width. The extent of a crack stands for its length. The limits below are
-- this project's own and follow no standard:
--   crack     severe from 2.0 m, moderate from 0.5 m
--   spalling  severe from 1.0 m or 0.5 m2 (falling pieces), moderate from 0.3 m
--   moisture  severe from 3.0 m or 4 m2, moderate from 1.0 m
-- minor: whatever is smaller. Extents are those of the box on the surface, so a slanting crack is shorter than its box.
SELECT
    defect_id,
    CASE defect_class
        WHEN 'crack' THEN CASE
            WHEN greatest(width_m, height_m) >= 2.0 THEN 'severe'
            WHEN greatest(width_m, height_m) >= 0.5 THEN 'moderate'
            ELSE 'minor'
        END
        WHEN 'spalling' THEN CASE
            WHEN greatest(width_m, height_m) >= 1.0 OR area_m2 >= 0.5 THEN 'severe'
            WHEN greatest(width_m, height_m) >= 0.3 THEN 'moderate'
            ELSE 'minor'
        END
        WHEN 'moisture' THEN CASE
            WHEN greatest(width_m, height_m) >= 3.0 OR area_m2 >= 4.0 THEN 'severe'
            WHEN greatest(width_m, height_m) >= 1.0 THEN 'moderate'
            ELSE 'minor'
        END
    END AS severity
FROM defects
