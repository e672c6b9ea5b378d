"""Sources of training and validation pictures, and their shares."""

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
VALIDATION_INTERVAL = 40  # every 40th generated picture is for validation


@dataclass(frozen=True, kw_only=True)
class Source:
    """Pictures of one kind; ``share``: weight of the kind in the random choice of training pictures."""

    name: str
    share: float
    samples: Sequence[Sample]


def read_training_sources(data: Path, generated: Sequence[Path]) -> tuple[Source, ...]:
    """The sources that the shipped detector is trained on.

    Args:
        data: folder with `defects` and `drone`.
        generated: folders written by training.generate; without any, only cracks are trained.
    """
    cracks = [sample for sample in read_cracks(data / "defects") if sample.split is Split.TRAIN]
    negatives = [sample for sample in read_negatives(data) if sample.split is Split.TRAIN]
    pictures = [sample for folder in generated for sample in _split_generated(folder)[0]]
    real = (
        Source(name="cracks", share=0.35, samples=cracks),
        Source(name="negatives", share=0.2, samples=negatives),
    )
    return (*real, Source(name="generated", share=0.45, samples=pictures)) if pictures else real


def read_validation_samples(data: Path) -> tuple[Sample, ...]:
    """Real pictures of the validation sites, with cracks and without defects."""
    real = (*read_cracks(data / "defects"), *read_negatives(data))
    return tuple(sample for sample in real if sample.split is Split.VAL)


def read_evaluation_samples(folders: Sequence[Path]) -> tuple[Sample, ...]:
    """Real pictures for validation, not for training, from folders of training.data.evaluation_sets."""
    return tuple(sample for folder in folders for sample in read_pictures(folder, split=Split.VAL))


def read_generated_samples(generated: Sequence[Path]) -> tuple[Sample, ...]:
    """Generated pictures for validation, with all classes."""
    return tuple(sample for folder in generated for sample in _split_generated(folder)[1])


def _split_generated(folder: Path) -> tuple[list[Sample], list[Sample]]:
    """Generated pictures for training, and those for validation."""
    samples = read_pictures(folder)
    validation = range(0, len(samples), VALIDATION_INTERVAL)
    return [sample for i, sample in enumerate(samples) if i not in validation], [samples[i] for i in validation]
