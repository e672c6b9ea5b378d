-- History: what each campaign could see of the building, by which absence is told from not having been looked at.

-- coverage: one row per cell of a facade on an element
CREATE TABLE coverage (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    facade               VARCHAR NOT NULL,
    facade_azimuth_deg   DOUBLE NOT NULL,
    cell_column          BIGINT NOT NULL,
    cell_row             BIGINT NOT NULL,
    element_guid         VARCHAR NOT NULL,
    cell_layer           BIGINT NOT NULL,
    storey               VARCHAR,
    coverage_outcome     VARCHAR NOT NULL,
    u_min_m              DOUBLE NOT NULL,
    u_max_m              DOUBLE NOT NULL,
    v_min_m              DOUBLE NOT NULL,
    v_max_m              DOUBLE NOT NULL,
    area_m2              DOUBLE NOT NULL,
    x_site_m             DOUBLE NOT NULL,
    y_site_m             DOUBLE NOT NULL,
    z_site_m             DOUBLE NOT NULL,
    normal_x             DOUBLE NOT NULL,
    normal_y             DOUBLE NOT NULL,
    normal_z             DOUBLE NOT NULL,
    imaged_count         BIGINT NOT NULL,
    searched_count       BIGINT NOT NULL,
    hidden_share         DOUBLE,
    best_photo_id        VARCHAR,
    gsd_mm               DOUBLE,
    incidence_deg        DOUBLE,
    blur_px              DOUBLE,
    found_crack_width_mm DOUBLE,
    found_patch_mm       DOUBLE,
    geometry             GEOMETRY NOT NULL
);
COMMENT ON COLUMN coverage.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';
