-- The field's words for columns, and which cache entries a run's tables were made of.

ALTER TABLE runs ADD COLUMN stage_keys VARCHAR;
ALTER TABLE defects RENAME COLUMN sightings TO photo_count;
ALTER TABLE defects RENAME COLUMN position_from TO position_method;
ALTER TABLE merges RENAME COLUMN apart_m TO separation_m;
ALTER TABLE merges RENAME COLUMN apart_sigma TO mahalanobis_distance;
ALTER TABLE georeference RENAME COLUMN tie_inflation TO tie_variance_factor;
ALTER TABLE georeference RENAME COLUMN shift_score TO edge_score;
ALTER TABLE georeference RENAME COLUMN competing_score TO edge_score_runner_up;
ALTER TABLE reviews RENAME COLUMN judged_class TO reviewed_class;
ALTER TABLE reviews RENAME COLUMN judged_box_x_px TO reviewed_box_x_px;
ALTER TABLE reviews RENAME COLUMN judged_box_y_px TO reviewed_box_y_px;
ALTER TABLE reviews RENAME COLUMN judged_box_width_px TO reviewed_box_width_px;
ALTER TABLE reviews RENAME COLUMN judged_box_height_px TO reviewed_box_height_px;
