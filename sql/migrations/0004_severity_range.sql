-- Grades within the error of the crack width, and the part of that error by which a width may be overstated.

ALTER TABLE defects ADD COLUMN severity_low VARCHAR;
ALTER TABLE defects ADD COLUMN severity_high VARCHAR;
ALTER TABLE defects ADD COLUMN crack_width_blur_mm DOUBLE;

-- What tells the offset of a photograph's clock from UTC; null for what is in the lake already.
ALTER TABLE photos ADD COLUMN utc_offset VARCHAR;
