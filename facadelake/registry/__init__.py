"""The registry of buildings: who is inspected, from which files, how, and when."""

from facadelake.registry.building import (
    DEFAULT_MODEL,
    Building,
    BuildingCrs,
    CocoDetector,
    OnnxDetectorSetting,
    Schedule,
    Tolerances,
)
from facadelake.registry.portfolio import Portfolio, read_portfolio

__all__ = [
    "DEFAULT_MODEL",
    "Building",
    "BuildingCrs",
    "CocoDetector",
    "OnnxDetectorSetting",
    "Portfolio",
    "Schedule",
    "Tolerances",
    "read_portfolio",
]
