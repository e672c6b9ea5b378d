-- grain: defect
-- meaning: a proposal in the three words of New York's facade inspection programme (FISP); a QEWI decides
-- severities: UNSAFE, SWARMP, SAFE
--
-- 1 RCNY 103-04 (Administrative Code 28-302) has a Qualified Exterior Wall Inspector (QEWI) call each condition UNSAFE
-- (hazardous to persons or property, to be repaired promptly), SWARMP (safe with repair and maintenance programme)
-- or SAFE. The rule gives no dimensions: it is a professional's judgement, much of it by touch. The limits below are
-- this project's own, chosen to err towards the worse word, so that what is proposed SAFE needs the least second look:
--   spalling  UNSAFE from 0.10 m across or 0.01 m2: a piece of that size can fall and injure; smaller: SWARMP
--   crack     UNSAFE from 5 mm wide (BRE 251: the wall needs opening up), or over 3.0 m long, a storey, unless it was
--             measured narrower than 1 mm; SAFE where it was measured narrower than 0.1 mm (hairline);
--             else SWARMP, so always where its width is not measured and it is shorter. Narrower than the photographs
--             can tell (below_limit) counts as narrower than their limit
--   moisture  SWARMP: water in a wall is to be repaired and is no hazard by itself
-- Height is not used: what falls from a first floor injures, too. Not known here, and the QEWI's to add: what is loose
-- to the touch, what lies above a pavement, and SWARMP of the last cycle that was not repaired: UNSAFE by the rule.
SELECT
    defect_id,
    CASE defect_class
        WHEN 'spalling' THEN CASE
            WHEN coalesce(length_m, greatest(width_m, height_m)) >= 0.10 OR area_m2 >= 0.01 THEN 'UNSAFE'
            ELSE 'SWARMP'
        END
        WHEN 'crack' THEN CASE
            WHEN crack_width_mm >= 5.0 THEN 'UNSAFE'
            WHEN crack_width_mm < 0.1 OR (crack_width_outcome = 'below_limit' AND crack_width_limit_mm <= 0.1) THEN 'SAFE'
            WHEN crack_width_outcome = 'below_limit' AND crack_width_limit_mm <= 1.0 THEN 'SWARMP'
            WHEN coalesce(length_m, greatest(width_m, height_m)) > 3.0 AND coalesce(crack_width_mm, 1.0) >= 1.0
                THEN 'UNSAFE'
            ELSE 'SWARMP'
        END
        WHEN 'moisture' THEN 'SWARMP'
    END AS severity
FROM defects
