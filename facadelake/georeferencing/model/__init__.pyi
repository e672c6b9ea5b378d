from .control import build_model_control as build_model_control
from .control import build_target_surface as build_target_surface
