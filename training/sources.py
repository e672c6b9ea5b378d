"""Which pictures are learned from, and how often each kind is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.reviews.training import Split
from training.data.cracks import read_cracks
from training.data.negatives import read_negatives
from training.data.sample import Sample
from training.generate.folder import read_pictures

TRAINED_ON = (
    "crack_boxes_640 (github.com/2024uce0062-sys/crack-detection-ai, Roboflow 'crack detection project', CC BY 4.0 "
    "stated by the uploader; holds pictures of CrackForest and CRACK500): sites of the split 'train'",
    "omu_quay_crack_yolo, quay k1 (github.com/omu-geolab/CrackImageDatasetForDeepLearning, Osaka Metropolitan "
    "University, CC BY-SA 4.0; Komi, Yoshida, Kameyama, Sensors 2025, 25, 4325)",
    "facade_negatives (github.com/a-hwang/building-facade-segmentation, CC BY 4.0): facades without defects",
    "lund_street (BSD): street photographs without defects",
    "pictures drawn by training.generate on grounds of the sets above",
    "started from YOLOX-nano trained on COCO by Megvii (Apache-2.0)",
)
KEPT_BACK = 40  # of so many generated pictures one is


@dataclass(frozen=True, kw_only=True)
class Source:
    """Pictures of one kind; ``share`` of what is shown comes from it."""

    name: str
    share: float
    samples: Sequence[Sample]


def training_sources(data: Path, generated: Sequence[Path]) -> tuple[Source, ...]:
    """What the shipped detector learns from.

    ``data`` holds `defects` and `drone`, ``generated`` are folders written by training.generate; without any, only
    cracks are learned.
    """
    cracks = [sample for sample in read_cracks(data / "defects") if sample.split is Split.TRAIN]
    negatives = [sample for sample in read_negatives(data) if sample.split is Split.TRAIN]
    drawn = [sample for folder in generated for sample in _drawn(folder)[0]]
    real = (
        Source(name="cracks", share=0.35, samples=cracks),
        Source(name="negatives", share=0.2, samples=negatives),
    )
    return (*real, Source(name="generated", share=0.45, samples=drawn)) if drawn else real


def validation_samples(data: Path) -> tuple[Sample, ...]:
    """Real pictures of the sites kept for choosing: with cracks, and without defects."""
    real = (*read_cracks(data / "defects"), *read_negatives(data))
    return tuple(sample for sample in real if sample.split is Split.VAL)


def judged_samples(folders: Sequence[Path]) -> tuple[Sample, ...]:
    """Real pictures to choose by, not to learn from, in folders with coco.json and images (training.data.judged)."""
    return tuple(sample for folder in folders for sample in read_pictures(folder, split=Split.VAL))


def drawn_samples(generated: Sequence[Path]) -> tuple[Sample, ...]:
    """Generated pictures that are not learned from: the only ones with boxes of spalling and moisture."""
    return tuple(sample for folder in generated for sample in _drawn(folder)[1])


def _drawn(folder: Path) -> tuple[list[Sample], list[Sample]]:
    """Generated pictures to learn from, and one in twenty that is kept back."""
    samples = read_pictures(folder)
    kept = range(0, len(samples), KEPT_BACK)
    return [sample for i, sample in enumerate(samples) if i not in kept], [samples[i] for i in kept]
