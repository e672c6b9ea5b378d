"""Real pictures in which no defect is known: facades and a street, on which a detector must stay quiet."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from training.data.sample import Sample
from training.data.sites import sites_of


def read_facades(defects: Path) -> tuple[Sample, ...]:
    """The 70 pictures of `facade_negatives`, split by building; `defects` is the folder `data/defects`."""
    folder = defects / "facade_negatives"
    return _free_of_defects("facade_negatives", {path.name.split("_png_jpg")[0]: path for path in folder.glob("*.jpg")})


def read_lund_street(drone: Path) -> tuple[Sample, ...]:
    """The street facades of `data/drone/lund_street`; those that show the houses of both ends are left out."""
    return _free_of_defects("lund_street", {path.stem: path for path in (drone / "lund_street").glob("*.jpg")})


def read_negatives(data: Path) -> tuple[Sample, ...]:
    """Every real picture without defects, with its split; `data` holds `defects` and `drone`."""
    return (*read_facades(data / "defects"), *read_lund_street(data / "drone"))


def _free_of_defects(set_name: str, pictures: dict[str, Path]) -> tuple[Sample, ...]:
    sites = sites_of(set_name)
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
