"""COCO annotations of the defects: exact boxes, and boxes with the errors of a detector."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64x2
from facadelake.demo.photographs.flight import DemoExposure
from facadelake.demo.photographs.visibility import ProjectedDefect
from facadelake.demo.textures.lighting import RayScene

CATEGORIES = {"crack": 1, "spalling": 2, "moisture": 3}
OFF_TARGET = "off_target"
MISSED_SHARE, WRONG_CLASS_SHARE, FALSE_SHARE = 0.07, 0.04, 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxAnnotation:
    """A box: photograph, class, centre and size in pixels, score, and the check point that it shows."""

    file_name: str
    kind: str
    centre_px: Float64x2
    size_px: Float64x2
    score: float
    checkpoint_id: str


def make_exact_boxes(
    projected: Sequence[ProjectedDefect], on_target: set[str], rng: np.random.Generator
) -> list[BoxAnnotation]:
    """A box around every projected defect; those of the surroundings are off target."""
    return [
        BoxAnnotation(
            file_name=s.exposure.file_name,
            kind=s.grid.defect.kind,
            centre_px=s.centre_px,
            size_px=s.size_px,
            score=float(np.round(rng.uniform(0.6, 0.97), 3)),
            checkpoint_id=s.grid.defect.id if s.grid.defect.id in on_target else OFF_TARGET,
        )
        for s in projected
    ]


def make_noisy_boxes(
    exact: Sequence[BoxAnnotation],
    false: Sequence[BoxAnnotation],
    exposures: Sequence[DemoExposure],
    rng: np.random.Generator,
) -> list[BoxAnnotation]:
    """The boxes of a detector with errors: some missed, some of the wrong class, all with noise, and false ones.

    Args:
        exact: the exact boxes.
        false: boxes without a defect, appended.
        exposures: the photographs, to whose size boxes are cut.
        rng: draws the errors.
    """
    limits = {s.file_name: (s.posed.camera.width_px, s.posed.camera.height_px) for s in exposures}
    out = []
    for box in exact:
        if rng.uniform() < MISSED_SHARE:
            continue
        size = box.size_px * np.exp(rng.normal(scale=0.10, size=2))
        centre = box.centre_px + rng.normal(scale=0.05, size=2) * box.size_px + rng.normal(scale=0.5, size=2)
        limit = np.array(limits[box.file_name], dtype=np.float64)
        low, high = np.clip(centre - size / 2, 0, limit), np.clip(centre + size / 2, 0, limit)
        if (high - low).min() < 2:
            continue
        others = [k for k in CATEGORIES if k != box.kind]
        kind = str(rng.choice(others)) if rng.uniform() < WRONG_CLASS_SHARE else box.kind
        score = float(np.round(np.clip(box.score + rng.normal(scale=0.05), 0.3, 0.99), 3))
        out.append(
            BoxAnnotation(
                file_name=box.file_name,
                kind=kind,
                centre_px=(low + high) / 2,
                size_px=high - low,
                score=score,
                checkpoint_id=box.checkpoint_id,
            )
        )
    return [*out, *false]


def make_false_boxes(
    count: int, exposures: Sequence[DemoExposure], rays: RayScene, modelled: set[int], rng: np.random.Generator
) -> list[BoxAnnotation]:
    """Boxes on trees, ground, neighbours or obstacles: the rays of centre and corners miss the model.

    Args:
        count: number of boxes.
        exposures: the photographs.
        rays: the scene.
        modelled: groups of the scene that belong to the model.
        rng: draws photograph, position, size, class and score.
    """
    out: list[BoxAnnotation] = []
    while len(out) < count:
        exposure = exposures[int(rng.integers(len(exposures)))]
        camera = exposure.posed.camera
        size = rng.uniform(0.012, 0.04, 2) * camera.width_px
        centre = rng.uniform(size / 2, np.array([camera.width_px, camera.height_px]) - size / 2)
        # The corners of the box must miss the building as well.
        corners = np.array([[0, 0], [-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 + centre
        distance, group = rays.cast(*exposure.posed.rays_site_from_img(corners))
        if not np.isfinite(distance).all() or any(int(g) in modelled for g in group):
            continue
        kind = str(rng.choice(list(CATEGORIES)))
        out.append(
            BoxAnnotation(
                file_name=exposure.file_name,
                kind=kind,
                centre_px=centre,
                size_px=size,
                score=float(np.round(rng.uniform(0.3, 0.75), 3)),
                checkpoint_id=OFF_TARGET,
            )
        )
    return out


def write_coco(path: Path, boxes: Sequence[BoxAnnotation], exposures: Sequence[DemoExposure]) -> None:
    """Write boxes as COCO; annotation ids follow their order, from 1."""
    ids = {name: i for i, name in enumerate(sorted(s.file_name for s in exposures), start=1)}
    camera = exposures[0].posed.camera
    annotations: list[dict[str, Any]] = []
    for number, box in enumerate(boxes, start=1):
        (x, y), (w, h) = box.centre_px - box.size_px / 2, box.size_px
        annotations.append(
            {
                "id": number,
                "image_id": ids[box.file_name],
                "category_id": CATEGORIES[box.kind],
                "bbox": [round(float(n), 2) for n in (x, y, w, h)],
                "area": round(float(w * h), 1),
                "iscrowd": 0,
                "score": box.score,
            }
        )
    images = [{"id": i, "file_name": n, "width": camera.width_px, "height": camera.height_px} for n, i in ids.items()]
    categories = [{"id": i, "name": n} for n, i in CATEGORIES.items()]
    path.write_text(json.dumps({"images": images, "categories": categories, "annotations": annotations}, indent=1))
