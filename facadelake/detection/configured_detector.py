"""The detector that a building's portfolio entry configures."""

from __future__ import annotations

import os
from pathlib import Path

from facadelake.detection.card import ModelCard
from facadelake.detection.inference.card_lookup import find_card
from facadelake.detection.inference.detector import OnnxDetector, hash_detector, load_detector
from facadelake.detection.model_registry import find_default_model
from facadelake.registry import DEFAULT_MODEL, Building, OnnxDetectorSetting


def resolve_default_model(building: Building) -> Building:
    """The building with ``model: default`` replaced by the current default file.

    A run keeps the detector it began with, even if another is promoted meanwhile.
    Raises ModelError if there is no default model.
    """
    setting = building.detector
    if not isinstance(setting, OnnxDetectorSetting) or setting.model != DEFAULT_MODEL:
        return building
    return building.model_copy(update={"detector": setting.model_copy(update={"model": str(locate_model(setting))})})


def locate_model(setting: OnnxDetectorSetting) -> Path:
    """The ONNX file of a setting. Raises ModelError if it is ``default`` and there is no default model."""
    return find_default_model() if setting.model == DEFAULT_MODEL else Path(setting.model)


def load_configured_detector(setting: OnnxDetectorSetting) -> OnnxDetector:
    """Load the model with one thread; ``count_threads`` batches of tiles are processed in parallel.

    Raises ModelError if the model or its card is missing, or the model is not as its card declares.
    """
    return load_detector(
        locate_model(setting), _locate_configured_card(setting), threads=1, score_threshold=setting.score_threshold
    )


def hash_configured_detector(setting: OnnxDetectorSetting) -> str:
    """A key of all that determines the model's detections. Raises as ``hash_detector``."""
    return hash_detector(locate_model(setting), setting.classes, _locate_configured_card(setting))


def read_configured_card(setting: OnnxDetectorSetting) -> ModelCard:
    """The card of the model. Raises ModelError if there is none."""
    return find_card(locate_model(setting), _locate_configured_card(setting))


def count_threads(setting: OnnxDetectorSetting) -> int:
    """The portfolio's number of threads, else one per core that this process may use."""
    return setting.threads or len(os.sched_getaffinity(0))


def _locate_configured_card(setting: OnnxDetectorSetting) -> Path | None:
    return Path(setting.card) if setting.card else None
