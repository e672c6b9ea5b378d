-- grain: defect
-- meaning: cracks by their width: below 0.2 mm, up to 0.5 mm, wider
-- severities: severe, moderate, minor, not_measured, not_covered
--
-- The limits are those of the paper that this project follows: minor below 0.2 mm, moderate from 0.2 mm to 0.5 mm (both
-- ends included), severe above. The width is crack_width_mm, the mean across the crack on the surface. A pixel of 1 mm
-- cannot tell 0.2 mm from 0.5 mm: where the photographs could not (crack_width_outcome below_limit) the limit stands for
-- the width up to 0.5 mm, and the word is the worst that it can be; a wider limit, or nothing known: not_measured, never
-- guessed. Look at crack_width_sigma_mm before trusting a step. Other classes are not_covered.
SELECT
    defect_id,
    CASE
        WHEN defect_class <> 'crack' THEN 'not_covered'
        WHEN crack_width_mm > 0.5 THEN 'severe'
        WHEN crack_width_mm >= 0.2 THEN 'moderate'
        WHEN crack_width_mm IS NOT NULL THEN 'minor'
        WHEN crack_width_outcome <> 'below_limit' THEN 'not_measured'
        WHEN crack_width_limit_mm <= 0.2 THEN 'minor'
        WHEN crack_width_limit_mm <= 0.5 THEN 'moderate'
        ELSE 'not_measured'
    END AS severity
FROM defects
