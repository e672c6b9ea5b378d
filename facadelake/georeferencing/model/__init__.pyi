from .control import build_model_control as build_model_control
