from .control import model_control as model_control
