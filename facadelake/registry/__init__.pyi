from .building import DEFAULT_MODEL as DEFAULT_MODEL
from .building import Building as Building
from .building import CocoDetectorSetting as CocoDetectorSetting
from .building import OnnxDetectorSetting as OnnxDetectorSetting
from .portfolio import Portfolio as Portfolio
from .portfolio import read_portfolio as read_portfolio
from .surface_kinds import UNITS_M as UNITS_M
from .surface_kinds import find_buffer_files as find_buffer_files
