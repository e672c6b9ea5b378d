"""How much memory an inspection takes: measured in earlier runs of the building, else estimated from its photographs.

The estimate is the sum of what was measured (docs/portfolio.md has the runs): the process with its libraries, the
building and its tables, and the larger one of reconstruction, which grows with the pixels of a photograph in each
thread, and georeferenced adjustment, which grows with the number of photographs. It errs upwards: a campaign that
waits costs time, one that is killed costs its run.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

MIB = 2**20
_PROCESS_MIB = 1700  # 890 to 1,250 in all stages but load-model, which took 1,640
_RECONSTRUCTION_MIB = 400  # pycolmap's process beside it, before the first photograph
_BYTES_PER_DECODED_PIXEL = 5  # of sfm/worker/features.py, which limits its threads by them
_BYTES_PER_SCALE_SPACE_PIXEL = 40
_ADJUSTMENT_MIB_PER_PHOTOGRAPH = 6  # 1.8 GB of 300 photographs, 5.7 GB of 1,000
_ESTIMATE_MARGIN = 1.2
_MEASURED_MARGIN = 1.3  # drawing, after the commit, is not in table runs; it took up to 1.2 times the stages' peak
_KILLED_MARGIN = 1.5  # it needed more than it had when it was killed
_RUNS = 3


@dataclass(frozen=True, kw_only=True)
class CampaignSize:
    """What memory depends on: the number of photographs, and the pixels of the largest one."""

    photographs: int
    largest_px: int


@dataclass(frozen=True, kw_only=True)
class MeasuredRun:
    """A run of a building that read its photographs: its peak memory, and the size of its campaign."""

    peak_mib: float
    size: CampaignSize


@dataclass(frozen=True, kw_only=True)
class MemoryNeed:
    """Memory that an inspection may take, and what is known of it."""

    mib: float
    basis: str


def parse_peak(stage_peak_mib: str) -> float | None:
    """The peak memory of a run by its column ``stage_peak_mib``; None where it took its photographs from the cache."""
    peaks: dict[str, float] = json.loads(stage_peak_mib)
    return max(peaks.values()) if "ingest" in peaks else None


def estimate_memory(size: CampaignSize, *, max_image_px: int, threads: int) -> float:
    """Estimate the memory of an inspection in MiB.

    ``max_image_px`` is the longer side to which photographs are reduced before feature extraction; ``threads`` are the
    machine's.
    """
    reduced = min(size.largest_px, max_image_px**2)
    of_thread = size.largest_px * _BYTES_PER_DECODED_PIXEL + reduced * _BYTES_PER_SCALE_SPACE_PIXEL
    reconstruction = _RECONSTRUCTION_MIB + threads * of_thread / MIB
    adjustment = _ADJUSTMENT_MIB_PER_PHOTOGRAPH * size.photographs
    return _ESTIMATE_MARGIN * (_PROCESS_MIB + max(reconstruction, adjustment))


def find_memory_need(
    size: CampaignSize,
    runs: Sequence[MeasuredRun],
    *,
    max_image_px: int,
    threads: int,
    killed_at_mib: float | None = None,
) -> MemoryNeed:
    """What an inspection may take.

    Args:
        size: of the campaign.
        runs: measured runs of the building, the newest last.
        max_image_px: the longer side to which photographs are reduced before feature extraction.
        threads: number of threads.
        killed_at_mib: memory of the last attempt when it was killed; None: it was not.

    Returns:
        The need with its basis. A campaign that is larger than the measured ones takes more by what the estimates
        differ.
    """
    estimate = estimate_memory(size, max_image_px=max_image_px, threads=threads)
    if runs:
        grown = [
            _MEASURED_MARGIN * run.peak_mib
            + max(0.0, estimate - estimate_memory(run.size, max_image_px=max_image_px, threads=threads))
            for run in runs[-_RUNS:]
        ]
        need = MemoryNeed(mib=max(grown), basis=f"measured in {len(grown)} run(s) of the building")
    else:
        megapixels = size.largest_px / 1e6
        basis = f"estimated for {size.photographs} photographs of up to {megapixels:.1f} megapixels"
        need = MemoryNeed(mib=estimate, basis=basis)
    if killed_at_mib is not None and _KILLED_MARGIN * killed_at_mib > need.mib:
        return MemoryNeed(
            mib=_KILLED_MARGIN * killed_at_mib, basis=f"was killed at {killed_at_mib / 1024:.1f} GiB before"
        )
    return need
