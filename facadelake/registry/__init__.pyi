from .building import Building as Building
from .portfolio import Portfolio as Portfolio
from .portfolio import read_portfolio as read_portfolio
from .settings import DEFAULT_MODEL as DEFAULT_MODEL
from .settings import CocoDetectorSetting as CocoDetectorSetting
from .settings import OnnxDetectorSetting as OnnxDetectorSetting
from .surface_kinds import UNITS_M as UNITS_M
from .surface_kinds import find_buffer_files as find_buffer_files
