"""Which pictures are learned from, and how often each kind is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from training.data.cracks import read_cracks
from training.data.negatives import read_negatives
from training.data.sample import Sample, Split


@dataclass(frozen=True, kw_only=True)
class Source:
    """Pictures of one kind; ``share`` of what is shown comes from it."""

    name: str
    share: float
    samples: Sequence[Sample]


def training_sources(data: Path) -> tuple[Source, ...]:
    """What the shipped detector learns from; ``data`` holds `defects` and `drone`."""
    cracks = [sample for sample in read_cracks(data / "defects") if sample.split is Split.TRAIN]
    negatives = [sample for sample in read_negatives(data) if sample.split is Split.TRAIN]
    return (
        Source(name="cracks", share=0.65, samples=cracks),
        Source(name="negatives", share=0.35, samples=negatives),
    )


def validation_samples(data: Path) -> tuple[Sample, ...]:
    """Real pictures of the sites kept for choosing: with cracks, and without defects."""
    real = (*read_cracks(data / "defects"), *read_negatives(data))
    return tuple(sample for sample in real if sample.split is Split.VAL)
