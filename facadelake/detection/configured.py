"""The detector that a building's registry entry means."""

from __future__ import annotations

import os
from pathlib import Path

from facadelake.detection.inference.detector import OnnxDetector, detector_fingerprint, load_detector
from facadelake.detection.model_registry import default_model
from facadelake.registry import DEFAULT_MODEL, Building, OnnxDetectorSetting


def resolve_default_model(building: Building) -> Building:
    """The building with the file that ``default`` means now in its place: a promotion does not reach a run under way.

    Raises ModelError where there is no default model.
    """
    setting = building.detector
    if not isinstance(setting, OnnxDetectorSetting) or setting.model != DEFAULT_MODEL:
        return building
    return building.model_copy(update={"detector": setting.model_copy(update={"model": str(model_file(setting))})})


def model_file(setting: OnnxDetectorSetting) -> Path:
    """The ONNX file that is meant. Raises ModelError where it is ``default`` and there is none."""
    return default_model() if setting.model == DEFAULT_MODEL else Path(setting.model)


def chosen_detector(setting: OnnxDetectorSetting) -> OnnxDetector:
    """The model, of one thread: as many tiles are looked at side by side as ``threads_of`` says.

    Raises ModelError where the model, or its card, is missing or not as declared.
    """
    return load_detector(model_file(setting), _card(setting), threads=1, score_threshold=setting.score_threshold)


def chosen_fingerprint(setting: OnnxDetectorSetting) -> str:
    """A key of what the model would find. Raises as ``detector_fingerprint`` does."""
    return detector_fingerprint(model_file(setting), setting.classes, _card(setting))


def threads_of(setting: OnnxDetectorSetting) -> int:
    """The threads that the registry allows, or one for each core that this process may use."""
    return setting.threads or len(os.sched_getaffinity(0))


def _card(setting: OnnxDetectorSetting) -> Path | None:
    return Path(setting.card) if setting.card else None
