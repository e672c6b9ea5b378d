-- table: coverage
-- grain: cell of a facade on an element
-- meaning: the bounds of a cell are within its square of 0.25 m, in which its position is
SELECT facade, cell_column, cell_row, u_min_m, u_max_m, v_min_m, v_max_m
FROM (
    SELECT
        *,
        radians(facade_azimuth_deg) AS azimuth,
        -- To the right as seen from outside, of a facade that faces the azimuth clockwise from north.
        -x_site_m * cos(azimuth) + y_site_m * sin(azimuth) AS u_m
    FROM coverage
)
WHERE u_min_m < 0.25 * cell_column - 1e-6
   OR u_max_m > 0.25 * (cell_column + 1) + 1e-6
   OR v_min_m < 0.25 * cell_row - 1e-6
   OR v_max_m > 0.25 * (cell_row + 1) + 1e-6
   OR u_m NOT BETWEEN u_min_m - 1e-6 AND u_max_m + 1e-6
   OR z_site_m NOT BETWEEN v_min_m - 1e-6 AND v_max_m + 1e-6
