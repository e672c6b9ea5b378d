"""Names that are used, although vulture sees no use (`make lint`); each group with its reason.

Commands, flows and validators are recognised by their decorators: ``[tool.vulture]`` in pyproject.toml.
"""

# Options of ONNX Runtime
_.intra_op_num_threads
_.log_severity_level

# An attribute of SQLite's driver, and a column of the intake's ledger that is written by name
_.isolation_level
_.received_s

# What the tests of crack measurement draw and compare with (benchmarks/drawn_cracks.py)
_.widths_px
_.max_px
_.draw_wall

# What SAHI calls and reads on its detection models
_.set_model
_.kwargs
_.category_mapping
_.set_device
_.device
_.perform_inference
_._create_object_prediction_list_from_original_predictions
_._object_prediction_list_per_image

# Called by name in a process of its own (benchmarks/scale.py)
_.measure_mapping
_.measure_reconstruction
_.measure_extraction
_.measure_defaults

# Options and members of pycolmap
_.minloglevel
_.rig_id
_.random_seed
_.num_cameras_per_rig
_.num_rigs
_.num_frames_per_rig
_.match_config
_.match_sparsity
_.inlier_match_ratio
_.camera_has_prior_focal_length
_.camera_model_id
_.camera_params
_.camera_height
_.camera_width
_.point2D_stddev
_.corr_data_id
_.position_covariance
_.coordinate_system
_.max_image_size
_.max_num_features
_.peak_threshold
_.first_octave
_.match_list_path
_.min_model_size
_.max_num_models
_.snapshot_path
_.snapshot_frames_freq
_.ba_global_frames_ratio
_.ba_global_points_ratio
_.ba_global_max_refinements
_.ba_global_function_tolerance
_.ba_local_function_tolerance
_.abs_pose_min_num_inliers
_.filter_max_reproj_error
_.abs_pose_max_error
_.init_max_error
_.merge_max_reproj_error
_.complete_max_reproj_error
_.refine_principal_point
_.print_summary
_.loss_function_type
_.loss_function_scale
_.function_tolerance
_.estimate_focal_length
_.refine_focal_length

# Attributes that IfcOpenShell writes
_.OverallHeight
_.OverallWidth
_.time_stamp

# Configuration that pydantic reads
_.model_config

# Flag of numpy
_.writeable

# Fields that become keys of a JSON file (asdict, pydantic)
_.promoted_at
_.nearest_apart_m
_.median_ratio
_.p95_ratio
_.count_shown
_.without_site
_.map50
_.map50_95
_.made_at

# Attributes that pycocotools reads
_.iouThrs
_.recThrs
_.maxDets
_.areaRng
_.areaRngLbl
_.dataset

# Values of enumerations that a file or the command line names
_.NADIR
_.COPY

# Fields that become columns of the lake (vars)
_.model_uri
_.model_sha256
_.georeference_remarks
_.origin_lon_deg
_.origin_lat_deg
_.origin_height_ellipsoidal_m

# Option of Great Expectations
_.progress_bars

# Settings that the worker reads by key
_.max_image_px
_.max_features

# What import-linter calls on a contract (scripts/face_contract.py)
_.FaceContract
_.type_name
_.verbose
_.render_broken_contract

# Fields of ONNX
_.dim_param

# Of module warnings, set to record what Pillow warns about
_.showwarning

# Field of a report (evaluation/model_comparison)
_.facadelake

# What ast.NodeVisitor calls (core/source_code)
_.visit_JoinedStr

# Read by Prefect of the task that stands for a nested flow run (flows/campaign_runs.py)
_._is_subflow_tracking_task

# Field of a report (scheduling), read as JSON
_.need_mib
