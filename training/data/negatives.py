"""Real pictures without known defects, facades and a street: any detection on them is a false alarm."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from training.data.sample import Sample
from training.data.sites import read_sites


def read_facades(defects: Path) -> tuple[Sample, ...]:
    """The pictures of `facade_negatives`, split by building; `defects` is the folder `data/defects`."""
    folder = defects / "facade_negatives"
    return _create_negatives(
        "facade_negatives", {path.name.split("_png_jpg")[0]: path for path in folder.glob("*.jpg")}
    )


def read_lund_street(drone: Path) -> tuple[Sample, ...]:
    """The street facades of `data/drone/lund_street`, without the pictures that show houses of both splits."""
    return _create_negatives("lund_street", {path.stem: path for path in (drone / "lund_street").glob("*.jpg")})


def read_negatives(data: Path) -> tuple[Sample, ...]:
    """All real pictures without defects, with their splits; `data` contains `defects` and `drone`."""
    return (*read_facades(data / "defects"), *read_lund_street(data / "drone"))


def _create_negatives(set_name: str, pictures: dict[str, Path]) -> tuple[Sample, ...]:
    sites = read_sites(set_name)
    return tuple(
        Sample(
            path=path,
            boxes_px=np.zeros((0, 4), dtype=np.float64),
            classes=np.zeros(0, dtype=np.int64),
            site=sites[stem].name,
            split=sites[stem].split,
        )
        for stem, path in sorted(pictures.items())
        if stem in sites
    )
