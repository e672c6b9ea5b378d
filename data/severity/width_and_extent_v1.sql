-- grain: defect
-- meaning: cracks by width where it is measured, everything else by extent; a first sorting for a person, never a grade
-- severities: severe, moderate_or_worse, moderate, minor_or_worse, minor
--
-- crack, width measured: the limits of BRE Digest 251 (Burland), its six categories in three words
--   severe     wider than 15 mm (categories 4 and 5)
--   moderate   wider than 5 mm (category 3), or from 2.0 m long, whatever its width
--   minor      up to 5 mm (categories 0 to 2)
-- crack narrower than the photographs can tell (crack_width_outcome below_limit): its limit stands for the width up to
-- 5 mm; the word is then the worst that it can be.
-- crack, width not measured: by extent, and the word says that the width could make it worse
--   severe from 2.0 m, moderate_or_worse from 0.5 m, minor_or_worse if smaller
-- The other limits are those of extent_v1, this project's own:
--   spalling   severe from 1.0 m or 0.5 m2 (falling pieces), moderate from 0.3 m
--   moisture   severe from 3.0 m or 4 m2, moderate from 1.0 m
--   minor is whatever is smaller
-- The width is crack_width_mm, a mean; look at crack_width_sigma_mm before trusting a step. Extents are those of the box
-- on the surface, so a slanting crack is shorter than its box.
SELECT
    defect_id,
    CASE defect_class
        WHEN 'crack' THEN CASE
            WHEN known_width_mm > 15.0 THEN 'severe'
            WHEN known_width_mm > 5.0 THEN 'moderate'
            WHEN known_width_mm IS NOT NULL AND extent_m >= 2.0 THEN 'moderate'
            WHEN known_width_mm IS NOT NULL THEN 'minor'
            WHEN extent_m >= 2.0 THEN 'severe'
            WHEN extent_m >= 0.5 THEN 'moderate_or_worse'
            ELSE 'minor_or_worse'
        END
        WHEN 'spalling' THEN CASE
            WHEN extent_m >= 1.0 OR area_m2 >= 0.5 THEN 'severe'
            WHEN extent_m >= 0.3 THEN 'moderate'
            ELSE 'minor'
        END
        WHEN 'moisture' THEN CASE
            WHEN extent_m >= 3.0 OR area_m2 >= 4.0 THEN 'severe'
            WHEN extent_m >= 1.0 THEN 'moderate'
            ELSE 'minor'
        END
    END AS severity
FROM (
    SELECT
        defect_id,
        defect_class,
        area_m2,
        greatest(width_m, height_m) AS extent_m,
        CASE
            WHEN crack_width_mm IS NOT NULL THEN crack_width_mm
            WHEN crack_width_outcome = 'below_limit' AND crack_width_limit_mm <= 5.0 THEN crack_width_limit_mm
        END AS known_width_mm
    FROM defects
) AS sized
