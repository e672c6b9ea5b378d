from .bare import UNITS_M as UNITS_M
from .bare import files_beside as files_beside
from .building import DEFAULT_MODEL as DEFAULT_MODEL
from .building import Building as Building
from .building import CocoDetector as CocoDetector
from .building import OnnxDetectorSetting as OnnxDetectorSetting
from .portfolio import Portfolio as Portfolio
from .portfolio import read_portfolio as read_portfolio
