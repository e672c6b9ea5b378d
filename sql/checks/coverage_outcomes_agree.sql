-- table: coverage
-- grain: cell of a facade on an element
-- meaning: a cell is imaged where photographs show it and then has a best one with a pose; no more of them were searched
SELECT c.facade, c.cell_column, c.cell_row, c.coverage_outcome, c.imaged_count, c.searched_count, c.best_photo_id
FROM coverage AS c
LEFT JOIN poses AS p ON p.photo_id = c.best_photo_id AND p.x_site_m IS NOT NULL
WHERE (c.coverage_outcome = 'imaged') <> (c.imaged_count > 0)
   OR (c.imaged_count > 0) <> (p.photo_id IS NOT NULL AND c.gsd_mm IS NOT NULL AND c.incidence_deg IS NOT NULL)
   OR c.searched_count > c.imaged_count
   OR (c.searched_count = 0 AND (c.found_crack_width_mm IS NOT NULL OR c.found_patch_mm IS NOT NULL))
