"""The detector that a building's registry entry means."""

from __future__ import annotations

import os
from pathlib import Path

from facadelake.detection.inference.detector import OnnxDetector, hash_detector, load_detector
from facadelake.detection.model_registry import find_default_model
from facadelake.registry import DEFAULT_MODEL, Building, OnnxDetectorSetting


def resolve_default_model(building: Building) -> Building:
    """The building with the file that ``default`` means now in its place: a promotion does not reach a run under way.

    Raises ModelError where there is no default model.
    """
    setting = building.detector
    if not isinstance(setting, OnnxDetectorSetting) or setting.model != DEFAULT_MODEL:
        return building
    return building.model_copy(update={"detector": setting.model_copy(update={"model": str(locate_model(setting))})})


def locate_model(setting: OnnxDetectorSetting) -> Path:
    """The ONNX file that is meant. Raises ModelError where it is ``default`` and there is none."""
    return find_default_model() if setting.model == DEFAULT_MODEL else Path(setting.model)


def load_configured_detector(setting: OnnxDetectorSetting) -> OnnxDetector:
    """The model, of one thread: as many tiles are looked at side by side as ``count_threads`` says.

    Raises ModelError where the model, or its card, is missing or not as declared.
    """
    return load_detector(
        locate_model(setting), _locate_configured_card(setting), threads=1, score_threshold=setting.score_threshold
    )


def hash_configured_detector(setting: OnnxDetectorSetting) -> str:
    """A key of what the model would find. Raises as ``hash_detector`` does."""
    return hash_detector(locate_model(setting), setting.classes, _locate_configured_card(setting))


def count_threads(setting: OnnxDetectorSetting) -> int:
    """The threads that the registry allows, or one for each core that this process may use."""
    return setting.threads or len(os.sched_getaffinity(0))


def _locate_configured_card(setting: OnnxDetectorSetting) -> Path | None:
    return Path(setting.card) if setting.card else None
