-- grain: defect
-- meaning: cracks by their width: below 0.2 mm, up to 0.5 mm, wider
-- severities: severe, moderate, minor, not_measured, not_covered
--
-- The limits are those of the paper that this project follows: minor below 0.2 mm, moderate from 0.2 mm to 0.5 mm (both
-- ends included), severe above. The width is crack_width_mm, the mean across the crack on the surface, which needs a
-- mask: a crack known by its box alone is not_measured, never guessed. Other classes are not_covered.
-- A pixel of 1 mm cannot tell 0.2 mm from 0.5 mm: look at gsd_mm of the sightings before trusting the step.
SELECT
    defect_id,
    CASE
        WHEN defect_class <> 'crack' THEN 'not_covered'
        WHEN crack_width_mm IS NULL THEN 'not_measured'
        WHEN crack_width_mm > 0.5 THEN 'severe'
        WHEN crack_width_mm >= 0.2 THEN 'moderate'
        ELSE 'minor'
    END AS severity
FROM defects
