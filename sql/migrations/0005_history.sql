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

-- tracks: one row per defect of a building for life
CREATE TABLE tracks (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    track_id             VARCHAR NOT NULL,
    defect_class         VARCHAR NOT NULL,
    track_state          VARCHAR,
    withdrawn            BOOLEAN NOT NULL,
    first_campaign       VARCHAR,
    last_campaign        VARCHAR,
    detected_campaign    VARCHAR NOT NULL,
    defect_id            VARCHAR NOT NULL,
    first_seen_at        TIMESTAMP WITH TIME ZONE,
    last_seen_at         TIMESTAMP WITH TIME ZONE,
    detected_count       BIGINT NOT NULL,
    severity             VARCHAR NOT NULL,
    severity_rule        VARCHAR NOT NULL,
    x_site_m             DOUBLE NOT NULL,
    y_site_m             DOUBLE NOT NULL,
    z_site_m             DOUBLE NOT NULL,
    lon_deg              DOUBLE NOT NULL,
    lat_deg              DOUBLE NOT NULL,
    height_ellipsoidal_m DOUBLE NOT NULL,
    east_map_m           DOUBLE NOT NULL,
    north_map_m          DOUBLE NOT NULL,
    height_map_m         DOUBLE NOT NULL,
    normal_x             DOUBLE NOT NULL,
    normal_y             DOUBLE NOT NULL,
    normal_z             DOUBLE NOT NULL,
    sigma_east_m         DOUBLE,
    sigma_north_m        DOUBLE,
    sigma_up_m           DOUBLE,
    width_m              DOUBLE NOT NULL,
    height_m             DOUBLE NOT NULL,
    length_m             DOUBLE,
    area_m2              DOUBLE NOT NULL,
    crack_width_mm       DOUBLE,
    element_guid         VARCHAR NOT NULL,
    ifc_class            VARCHAR NOT NULL,
    element_name         VARCHAR,
    material             VARCHAR,
    storey               VARCHAR,
    facade               VARCHAR NOT NULL,
    facade_azimuth_deg   DOUBLE,
    best_photo_id        VARCHAR NOT NULL,
    best_photo_uri       VARCHAR,
    patch                GEOMETRY,
    geometry             GEOMETRY NOT NULL,
    trend_quantity       VARCHAR,
    trend_per_year       DOUBLE,
    trend_low_per_year   DOUBLE,
    trend_high_per_year  DOUBLE,
    trend_count          BIGINT,
    next_limit           DOUBLE,
    next_severity        VARCHAR,
    next_limit_from      TIMESTAMP WITH TIME ZONE,
    next_limit_at        TIMESTAMP WITH TIME ZONE,
    next_limit_to        TIMESTAMP WITH TIME ZONE,
    trend_remark         VARCHAR
);
COMMENT ON COLUMN tracks.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- track_states: one row per track in a campaign
CREATE TABLE track_states (
    building_id                 VARCHAR NOT NULL,
    campaign_id                 VARCHAR NOT NULL,
    run_id                      VARCHAR NOT NULL,
    track_id                    VARCHAR NOT NULL,
    track_state                 VARCHAR NOT NULL,
    state_evidence              VARCHAR NOT NULL,
    defect_id                   VARCHAR,
    defect_class                VARCHAR NOT NULL,
    state_remark                VARCHAR,
    match_probability           DOUBLE,
    previous_campaign           VARCHAR,
    years_since_previous        DOUBLE,
    length_change_m             DOUBLE,
    length_change_sigma_m       DOUBLE,
    area_change_m2              DOUBLE,
    area_change_sigma_m2        DOUBLE,
    crack_width_change_mm       DOUBLE,
    crack_width_change_sigma_mm DOUBLE,
    changed_quantity            VARCHAR,
    reviewer                    VARCHAR,
    geometry                    GEOMETRY NOT NULL
);
COMMENT ON COLUMN track_states.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- track_relations: one row per relation of a track in a campaign
CREATE TABLE track_relations (
    building_id    VARCHAR NOT NULL,
    campaign_id    VARCHAR NOT NULL,
    run_id         VARCHAR NOT NULL,
    track_id       VARCHAR NOT NULL,
    track_relation VARCHAR NOT NULL,
    other_track_id VARCHAR,
    detail         VARCHAR NOT NULL
);

-- track_candidates: one row per known defect and defect of a campaign that may be the same
CREATE TABLE track_candidates (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    track_id             VARCHAR NOT NULL,
    defect_id            VARCHAR NOT NULL,
    displacement_m       DOUBLE NOT NULL,
    mahalanobis_distance DOUBLE NOT NULL,
    log_odds             DOUBLE NOT NULL,
    match_probability    DOUBLE NOT NULL,
    matched              BOOLEAN NOT NULL
);

-- looks: one row per look at the place of a track in a campaign that did not detect it
CREATE TABLE looks (
    building_id             VARCHAR NOT NULL,
    campaign_id             VARCHAR NOT NULL,
    run_id                  VARCHAR NOT NULL,
    track_id                VARCHAR NOT NULL,
    compared_campaign       VARCHAR NOT NULL,
    defect_id               VARCHAR NOT NULL,
    look_verdict            VARCHAR NOT NULL,
    look_count              BIGINT NOT NULL,
    compared_count          BIGINT NOT NULL,
    look_photo_id           VARCHAR,
    compared_photo_id       VARCHAR,
    look_similarity         DOUBLE,
    surroundings_similarity DOUBLE,
    fading_extent           DOUBLE,
    fading_sigmas           DOUBLE,
    darkening_extent        DOUBLE,
    contrast_difference     DOUBLE,
    contrast_left           DOUBLE,
    look_cell_mm            DOUBLE
);

-- frame_offsets: one row per facade in a campaign, or the whole building (facade empty)
CREATE TABLE frame_offsets (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    facade               VARCHAR NOT NULL,
    offset_outcome       VARCHAR NOT NULL,
    offset_east_m        DOUBLE,
    offset_north_m       DOUBLE,
    offset_up_m          DOUBLE,
    offset_sigma_east_m  DOUBLE,
    offset_sigma_north_m DOUBLE,
    offset_sigma_up_m    DOUBLE,
    offset_count         BIGINT NOT NULL,
    found_again_share    DOUBLE,
    detail               VARCHAR NOT NULL
);

-- track_reviews: one row per review of a track in a campaign
CREATE TABLE track_reviews (
    building_id VARCHAR NOT NULL,
    campaign_id VARCHAR NOT NULL,
    run_id      VARCHAR NOT NULL,
    review_id   VARCHAR NOT NULL,
    track_id    VARCHAR NOT NULL,
    track_state VARCHAR NOT NULL,
    reviewer    VARCHAR NOT NULL,
    reviewed_at TIMESTAMP WITH TIME ZONE NOT NULL,
    note        VARCHAR
);
