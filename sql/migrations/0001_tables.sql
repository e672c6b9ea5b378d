-- The first tables, made from schemas/ by `python -m schemas.ddl`.
-- Never edit a migration that a lake outside has seen: add the next one.

-- buildings: one row per building in a campaign
CREATE TABLE buildings (
    building_id                 VARCHAR NOT NULL,
    campaign_id                 VARCHAR NOT NULL,
    run_id                      VARCHAR NOT NULL,
    building_name               VARCHAR NOT NULL,
    model_uri                   VARCHAR NOT NULL,
    model_sha256                VARCHAR NOT NULL,
    surface_kind                VARCHAR,
    map_crs                     VARCHAR NOT NULL,
    vertical_datum              VARCHAR NOT NULL,
    georeference_level          VARCHAR NOT NULL,
    georeference_remarks        VARCHAR,
    origin_lon_deg              DOUBLE NOT NULL,
    origin_lat_deg              DOUBLE NOT NULL,
    origin_height_ellipsoidal_m DOUBLE NOT NULL
);

-- campaigns: one row per campaign
CREATE TABLE campaigns (
    building_id      VARCHAR NOT NULL,
    campaign_id      VARCHAR NOT NULL,
    run_id           VARCHAR NOT NULL,
    photographs_uri  VARCHAR NOT NULL,
    photos_total     BIGINT NOT NULL,
    photos_localised BIGINT NOT NULL,
    detections_total BIGINT NOT NULL,
    defects_total    BIGINT NOT NULL,
    captured_from    TIMESTAMP WITH TIME ZONE,
    captured_to      TIMESTAMP WITH TIME ZONE
);

-- runs: one row per run
CREATE TABLE runs (
    building_id        VARCHAR NOT NULL,
    campaign_id        VARCHAR NOT NULL,
    run_id             VARCHAR NOT NULL,
    started_at         TIMESTAMP WITH TIME ZONE NOT NULL,
    finished_at        TIMESTAMP WITH TIME ZONE NOT NULL,
    inputs_sha256      VARCHAR NOT NULL,
    code_sha256        VARCHAR NOT NULL,
    detector_sha256    VARCHAR NOT NULL,
    facadelake_version VARCHAR NOT NULL,
    configuration      VARCHAR NOT NULL,
    stage_seconds      VARCHAR NOT NULL,
    stage_peak_mib     VARCHAR NOT NULL
);

-- photos: one row per file in the photographs' folder
CREATE TABLE photos (
    building_id              VARCHAR NOT NULL,
    campaign_id              VARCHAR NOT NULL,
    run_id                   VARCHAR NOT NULL,
    photo_id                 VARCHAR NOT NULL,
    sha256                   VARCHAR NOT NULL,
    bytes                    BIGINT NOT NULL,
    role                     VARCHAR,
    photo_outcome            VARCHAR NOT NULL,
    reason                   VARCHAR,
    image_width_px           BIGINT,
    image_height_px          BIGINT,
    camera_make              VARCHAR,
    camera_model             VARCHAR,
    focal_length_mm          DOUBLE,
    focal_length_35mm_mm     DOUBLE,
    taken_at                 TIMESTAMP WITH TIME ZONE,
    prior_source             VARCHAR NOT NULL,
    prior_lon_deg            DOUBLE,
    prior_lat_deg            DOUBLE,
    prior_height_m           DOUBLE,
    prior_height_datum       VARCHAR NOT NULL,
    prior_height_relative_m  DOUBLE,
    prior_sigma_horizontal_m DOUBLE,
    prior_sigma_vertical_m   DOUBLE,
    prior_yaw_deg            DOUBLE,
    prior_pitch_deg          DOUBLE,
    prior_roll_deg           DOUBLE,
    prior_sigma_yaw_deg      DOUBLE,
    prior_sigma_tilt_deg     DOUBLE,
    prior_evidence           VARCHAR,
    prior_focal_px           DOUBLE,
    prior_sigma_focal_px     DOUBLE,
    prior_focal_evidence     VARCHAR,
    prior_calibration        VARCHAR,
    prior_warnings           VARCHAR,
    camera_serial            VARCHAR,
    lens_model               VARCHAR,
    flight                   BIGINT,
    rtk_flag                 BIGINT
);

-- poses: one row per accepted photograph
CREATE TABLE poses (
    building_id           VARCHAR NOT NULL,
    campaign_id           VARCHAR NOT NULL,
    run_id                VARCHAR NOT NULL,
    photo_id              VARCHAR NOT NULL,
    pose_source           VARCHAR NOT NULL,
    reason                VARCHAR,
    x_site_m              DOUBLE,
    y_site_m              DOUBLE,
    z_site_m              DOUBLE,
    lon_deg               DOUBLE,
    lat_deg               DOUBLE,
    height_ellipsoidal_m  DOUBLE,
    qw                    DOUBLE,
    qx                    DOUBLE,
    qy                    DOUBLE,
    qz                    DOUBLE,
    image_width_px        BIGINT NOT NULL,
    image_height_px       BIGINT NOT NULL,
    fx_px                 DOUBLE,
    fy_px                 DOUBLE,
    cx_px                 DOUBLE,
    cy_px                 DOUBLE,
    k1                    DOUBLE,
    k2                    DOUBLE,
    p1                    DOUBLE,
    p2                    DOUBLE,
    reprojection_error_px DOUBLE,
    tie_points            BIGINT NOT NULL,
    sigma_east_m          DOUBLE,
    sigma_north_m         DOUBLE,
    sigma_up_m            DOUBLE,
    sigma_attitude_deg    DOUBLE,
    covariance            DOUBLE[],
    geometry              GEOMETRY
);
COMMENT ON COLUMN poses.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- georeference: one row per campaign
CREATE TABLE georeference (
    building_id           VARCHAR NOT NULL,
    campaign_id           VARCHAR NOT NULL,
    run_id                VARCHAR NOT NULL,
    control               VARCHAR NOT NULL,
    method                VARCHAR NOT NULL,
    map_crs               VARCHAR NOT NULL,
    vertical_datum        VARCHAR NOT NULL,
    georeference_level    VARCHAR NOT NULL,
    reference_campaign    VARCHAR,
    points_used           BIGINT NOT NULL,
    points_total          BIGINT NOT NULL,
    scale                 DOUBLE NOT NULL,
    residual_mean_m       DOUBLE,
    residual_rmse_m       DOUBLE,
    residual_max_m        DOUBLE,
    check_points          BIGINT NOT NULL,
    check_residual_mean_m DOUBLE,
    check_residual_max_m  DOUBLE,
    sigma_east_m          DOUBLE NOT NULL,
    sigma_north_m         DOUBLE NOT NULL,
    sigma_up_m            DOUBLE NOT NULL,
    gps_offset_east_m     DOUBLE,
    gps_offset_north_m    DOUBLE,
    gps_offset_up_m       DOUBLE,
    gps_offset_sigma_m    DOUBLE,
    tie_sigma_px          DOUBLE,
    tie_inflation         DOUBLE,
    model_residual_m      DOUBLE,
    doming_m              DOUBLE,
    doming_sigma_m        DOUBLE,
    edge_features         BIGINT,
    shift_score           DOUBLE,
    competing_score       DOUBLE,
    remarks               VARCHAR NOT NULL
);

-- georeference_points: one row per control point, held-out point or GPS prior
CREATE TABLE georeference_points (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    point_name           VARCHAR NOT NULL,
    point_kind           VARCHAR NOT NULL,
    x_site_m             DOUBLE NOT NULL,
    y_site_m             DOUBLE NOT NULL,
    z_site_m             DOUBLE NOT NULL,
    lon_deg              DOUBLE NOT NULL,
    lat_deg              DOUBLE NOT NULL,
    height_ellipsoidal_m DOUBLE NOT NULL,
    residual_east_m      DOUBLE NOT NULL,
    residual_north_m     DOUBLE NOT NULL,
    residual_up_m        DOUBLE NOT NULL,
    point_used           BOOLEAN NOT NULL,
    geometry             GEOMETRY NOT NULL
);
COMMENT ON COLUMN georeference_points.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- elements: one row per IFC element with a surface, or facade plane
CREATE TABLE elements (
    building_id        VARCHAR NOT NULL,
    campaign_id        VARCHAR NOT NULL,
    run_id             VARCHAR NOT NULL,
    element_guid       VARCHAR NOT NULL,
    ifc_class          VARCHAR NOT NULL,
    predefined_type    VARCHAR,
    element_name       VARCHAR,
    host_guid          VARCHAR,
    ifc_building       VARCHAR,
    storey             VARCHAR,
    storey_source      VARCHAR,
    material           VARCHAR,
    material_layers    VARCHAR,
    is_external        BOOLEAN,
    properties         VARCHAR,
    detail_level       VARCHAR,
    facade             VARCHAR NOT NULL,
    facade_azimuth_deg DOUBLE,
    surface_area_m2    DOUBLE NOT NULL,
    triangles          BIGINT NOT NULL,
    geometry           GEOMETRY
);
COMMENT ON COLUMN elements.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- detections: one row per box in a photograph
CREATE TABLE detections (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    detection_id         VARCHAR NOT NULL,
    photo_id             VARCHAR NOT NULL,
    source_annotation    VARCHAR,
    detection_outcome    VARCHAR NOT NULL,
    reason               VARCHAR,
    defect_class         VARCHAR,
    source_class         VARCHAR NOT NULL,
    score                DOUBLE NOT NULL,
    box_x_px             DOUBLE,
    box_y_px             DOUBLE,
    box_width_px         DOUBLE,
    box_height_px        DOUBLE,
    mask                 VARCHAR,
    crack_width_px       DOUBLE,
    crack_width_max_px   DOUBLE,
    crack_width_sigma_px DOUBLE,
    crack_width_limit_px DOUBLE,
    crack_length_px      DOUBLE,
    crack_line           VARCHAR,
    crack_width_outcome  VARCHAR,
    detector             VARCHAR NOT NULL,
    detector_sha256      VARCHAR NOT NULL
);

-- observations: one row per accepted detection
CREATE TABLE observations (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    detection_id         VARCHAR NOT NULL,
    photo_id             VARCHAR NOT NULL,
    observation_outcome  VARCHAR NOT NULL,
    reason               VARCHAR,
    defect_class         VARCHAR NOT NULL,
    defect_id            VARCHAR,
    x_site_m             DOUBLE,
    y_site_m             DOUBLE,
    z_site_m             DOUBLE,
    lon_deg              DOUBLE,
    lat_deg              DOUBLE,
    height_ellipsoidal_m DOUBLE,
    east_map_m           DOUBLE,
    north_map_m          DOUBLE,
    height_map_m         DOUBLE,
    normal_x             DOUBLE,
    normal_y             DOUBLE,
    normal_z             DOUBLE,
    sigma_east_m         DOUBLE,
    sigma_north_m        DOUBLE,
    sigma_up_m           DOUBLE,
    covariance_site      DOUBLE[],
    incidence_deg        DOUBLE,
    distance_m           DOUBLE,
    gsd_mm               DOUBLE,
    width_m              DOUBLE,
    height_m             DOUBLE,
    length_m             DOUBLE,
    area_m2              DOUBLE,
    crack_width_mm       DOUBLE,
    crack_width_max_mm   DOUBLE,
    crack_width_sigma_mm DOUBLE,
    crack_width_limit_mm DOUBLE,
    crack_length_m       DOUBLE,
    crack_width_outcome  VARCHAR,
    target_share         DOUBLE NOT NULL,
    occluder_gap_m       DOUBLE,
    element_guid         VARCHAR,
    storey               VARCHAR,
    facade               VARCHAR,
    patch                GEOMETRY,
    geometry             GEOMETRY
);
COMMENT ON COLUMN observations.patch IS 'EPSG:4979: longitude, latitude, ellipsoidal height';
COMMENT ON COLUMN observations.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- defects: one row per defect in a campaign
CREATE TABLE defects (
    building_id            VARCHAR NOT NULL,
    campaign_id            VARCHAR NOT NULL,
    run_id                 VARCHAR NOT NULL,
    defect_id              VARCHAR NOT NULL,
    defect_class           VARCHAR NOT NULL,
    severity               VARCHAR NOT NULL,
    severity_rule          VARCHAR NOT NULL,
    graded_by              VARCHAR,
    x_site_m               DOUBLE NOT NULL,
    y_site_m               DOUBLE NOT NULL,
    z_site_m               DOUBLE NOT NULL,
    lon_deg                DOUBLE NOT NULL,
    lat_deg                DOUBLE NOT NULL,
    height_ellipsoidal_m   DOUBLE NOT NULL,
    east_map_m             DOUBLE NOT NULL,
    north_map_m            DOUBLE NOT NULL,
    height_map_m           DOUBLE NOT NULL,
    normal_x               DOUBLE NOT NULL,
    normal_y               DOUBLE NOT NULL,
    normal_z               DOUBLE NOT NULL,
    sigma_east_m           DOUBLE,
    sigma_north_m          DOUBLE,
    sigma_up_m             DOUBLE,
    covariance_site        DOUBLE[],
    position_from          VARCHAR,
    deviation_from_model_m DOUBLE,
    deviation_sigma_m      DOUBLE,
    width_m                DOUBLE NOT NULL,
    height_m               DOUBLE NOT NULL,
    length_m               DOUBLE,
    area_m2                DOUBLE NOT NULL,
    crack_width_mm         DOUBLE,
    crack_width_max_mm     DOUBLE,
    crack_width_sigma_mm   DOUBLE,
    crack_width_limit_mm   DOUBLE,
    crack_length_m         DOUBLE,
    crack_width_outcome    VARCHAR,
    spread_m               DOUBLE NOT NULL,
    sightings              BIGINT NOT NULL,
    score                  DOUBLE NOT NULL,
    best_photo_id          VARCHAR NOT NULL,
    element_guid           VARCHAR NOT NULL,
    ifc_class              VARCHAR NOT NULL,
    element_name           VARCHAR,
    material               VARCHAR,
    storey                 VARCHAR,
    facade                 VARCHAR NOT NULL,
    patch                  GEOMETRY,
    geometry               GEOMETRY NOT NULL
);
COMMENT ON COLUMN defects.patch IS 'EPSG:4979: longitude, latitude, ellipsoidal height';
COMMENT ON COLUMN defects.geometry IS 'EPSG:4979: longitude, latitude, ellipsoidal height';

-- merges: one row per pair of sightings near one another
CREATE TABLE merges (
    building_id        VARCHAR NOT NULL,
    campaign_id        VARCHAR NOT NULL,
    run_id             VARCHAR NOT NULL,
    detection_id       VARCHAR NOT NULL,
    other_detection_id VARCHAR NOT NULL,
    defect_id          VARCHAR NOT NULL,
    other_defect_id    VARCHAR NOT NULL,
    merge_decision     VARCHAR NOT NULL,
    merge_reason       VARCHAR NOT NULL,
    apart_m            DOUBLE NOT NULL,
    apart_sigma        DOUBLE NOT NULL,
    overlap_share      DOUBLE,
    appearance_score   DOUBLE
);

-- integrity_views: one row per localised photograph
CREATE TABLE integrity_views (
    building_id               VARCHAR NOT NULL,
    campaign_id               VARCHAR NOT NULL,
    run_id                    VARCHAR NOT NULL,
    photo_id                  VARCHAR NOT NULL,
    integrity_outcome         VARCHAR NOT NULL,
    reason                    VARCHAR,
    ssim                      DOUBLE,
    compared_share            DOUBLE NOT NULL,
    depth_difference_median_m DOUBLE,
    depth_difference_p95_m    DOUBLE
);

-- checks: one row per expectation of a table
CREATE TABLE checks (
    building_id VARCHAR NOT NULL,
    campaign_id VARCHAR NOT NULL,
    run_id      VARCHAR NOT NULL,
    table_name  VARCHAR NOT NULL,
    expectation VARCHAR NOT NULL,
    column_name VARCHAR NOT NULL,
    passed      BOOLEAN NOT NULL,
    unexpected  BIGINT NOT NULL,
    detail      VARCHAR NOT NULL
);

-- reviews: one row per word of a person on a place of a photograph
CREATE TABLE reviews (
    building_id          VARCHAR NOT NULL,
    campaign_id          VARCHAR NOT NULL,
    run_id               VARCHAR NOT NULL,
    review_id            VARCHAR NOT NULL,
    subject              VARCHAR NOT NULL,
    photo_id             VARCHAR NOT NULL,
    detection_id         VARCHAR,
    defect_id            VARCHAR,
    verdict              VARCHAR NOT NULL,
    defect_class         VARCHAR,
    box_x_px             DOUBLE,
    box_y_px             DOUBLE,
    box_width_px         DOUBLE,
    box_height_px        DOUBLE,
    mask                 VARCHAR,
    judged_class         VARCHAR,
    judged_box_x_px      DOUBLE,
    judged_box_y_px      DOUBLE,
    judged_box_width_px  DOUBLE,
    judged_box_height_px DOUBLE,
    detector_sha256      VARCHAR,
    reviewer             VARCHAR NOT NULL,
    reviewed_at          TIMESTAMP WITH TIME ZONE NOT NULL,
    note                 VARCHAR
);
