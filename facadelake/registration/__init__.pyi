from .detection_registration import register_detections as register_detections
from .exclusion_mask import read_mask as read_mask
from .off_target import describe_off_target as describe_off_target
from .patch import compute_tangents as compute_tangents
from .settings import resolve_registration_settings as resolve_registration_settings
from .target_view import prepare_search_regions as prepare_search_regions
