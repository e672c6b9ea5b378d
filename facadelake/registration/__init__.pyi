from .register import register_detections as register_detections
from .settings import registration_settings as registration_settings
from .target_view import views_on_building as views_on_building
