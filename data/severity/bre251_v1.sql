-- grain: defect
-- meaning: cracks in masonry by width, in the six categories of BRE Digest 251 (Burland)
-- severities: very_severe, severe, moderate, slight, very_slight, negligible, not_measured, not_covered
--
-- Rests on the crack widths that BRE Digest 251 (Assessment of damage in low-rise buildings) and Burland, Broms and
-- de Mello (1977) give beside their categories:
--   5 very_severe  wider than 25 mm
--   4 severe       15 to 25 mm
--   3 moderate     5 to 15 mm
--   2 slight       up to 5 mm
--   1 very_slight  up to 1 mm
--   0 negligible   below 0.1 mm
-- In the Digest width is an aid alone: a category is decided by how the wall can be repaired, and several cracks of
-- more than 3 mm together can be moderate. A wall is graded there, here each crack by itself: a proposal from below.
-- The width is crack_width_mm, a mean. Where the photographs could not tell it (crack_width_outcome below_limit), the
-- limit stands for it up to 5 mm: the word is then the worst that it can be. A wider limit says too little, and a crack
-- of which nothing is known is not_measured. Other classes are not_covered.
SELECT
    defect_id,
    CASE
        WHEN defect_class <> 'crack' THEN 'not_covered'
        WHEN crack_width_mm > 25.0 THEN 'very_severe'
        WHEN crack_width_mm > 15.0 THEN 'severe'
        WHEN crack_width_mm > 5.0 THEN 'moderate'
        WHEN crack_width_mm > 1.0 THEN 'slight'
        WHEN crack_width_mm >= 0.1 THEN 'very_slight'
        WHEN crack_width_mm IS NOT NULL THEN 'negligible'
        WHEN crack_width_outcome <> 'below_limit' THEN 'not_measured'
        WHEN crack_width_limit_mm <= 0.1 THEN 'negligible'
        WHEN crack_width_limit_mm <= 1.0 THEN 'very_slight'
        WHEN crack_width_limit_mm <= 5.0 THEN 'slight'
        ELSE 'not_measured'
    END AS severity
FROM defects
