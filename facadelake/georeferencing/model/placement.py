"""Initial placement of a block by the building model: walls first, then edges along what walls do not determine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64x3
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.gps.alignment import align_to_gps
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.model.alignment import ModelAlignment, align_to_model
from facadelake.georeferencing.model.control import ModelControl
from facadelake.georeferencing.model.edge_search import EdgeShift
from facadelake.sfm import Reconstruction

# Heights without a datum may be off by the geoid; the search starts at plausible heights and has this sigma.
_SEARCH_SIGMA_M = 5.0
# Sigma of the datum after an alignment to walls, before the adjustment.
_WALLS_SIGMA_M = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelPlacement:
    """An initial placement by the model.

    ``shift``: None where the walls determine everything, or no edges are searched. ``datum_sigma_m`` (3,): sigma of the
    placement by walls and edges together, that of the edges by their agreement; None where a direction depends on GPS.
    """

    site_from_sfm: Similarity
    alignment: ModelAlignment
    shift: EdgeShift | None
    datum_sigma_m: Float64x3 | None
    remarks: tuple[str, ...]


def place_by_model(reconstruction: Reconstruction, priors: GpsPriors, model: ModelControl) -> ModelPlacement:
    """Similarity of the block to the model, from GPS on.

    Where heights have no stated datum, the take-off on the model's lowest level is a second start; the one with the
    better edge score is taken. Raises GeoreferenceError where the walls are not met, or two shifts fit equally well.
    """
    by_gps = align_to_gps(reconstruction, priors)
    placements: list[ModelPlacement] = []
    problems: list[GeoreferenceError] = []
    for correction_m in _list_height_corrections(priors, model.ground_site_m):
        corrected = priors.shift_height(correction_m)
        start = Similarity(
            rotation=by_gps.site_from_sfm.rotation,
            translation=by_gps.site_from_sfm.translation + np.array([0.0, 0.0, correction_m]),
            scale=by_gps.site_from_sfm.scale,
        )
        try:
            placements.append(_place_from(start, reconstruction, corrected, model))
        except GeoreferenceError as error:
            problems.append(error)
    if not placements:
        raise problems[0]
    return max(placements, key=lambda placement: placement.shift.score if placement.shift is not None else 0.0)


def _list_height_corrections(priors: GpsPriors, ground_site_m: float) -> list[float]:
    """Corrections (m) of the priors' heights to try: none, and, where the datum is unknown and heights above the
    take-off are known, the one that puts the take-off on the ground."""
    relative = priors.height_relative_m
    known = np.isfinite(relative)
    if not priors.datum_unknown or known.sum() < 3:
        return [0.0]
    correction_m = float(np.median(ground_site_m + relative[known] - priors.xyz_site_m[known, 2]))
    return [0.0] if abs(correction_m) < _SEARCH_SIGMA_M else [0.0, correction_m]


def _place_from(
    start: Similarity, reconstruction: Reconstruction, priors: GpsPriors, model: ModelControl
) -> ModelPlacement:
    alignment = align_to_model(start, reconstruction, priors, model.surface)
    free_directions = np.array([shift.direction for shift in alignment.shifts if not shift.observed]).reshape(-1, 3)
    if not len(free_directions) or model.edges is None:
        return ModelPlacement(
            site_from_sfm=alignment.site_from_sfm,
            alignment=alignment,
            shift=None,
            datum_sigma_m=None if len(free_directions) else np.full(3, _WALLS_SIGMA_M),
            remarks=alignment.remarks,
        )
    sigma_m = np.linalg.norm(np.minimum(priors.common_sigma_m, _SEARCH_SIGMA_M) * free_directions, axis=1)
    shift = model.edges.search_shift(build_cameras(reconstruction, alignment.site_from_sfm), free_directions, sigma_m)
    site_from_sfm = Similarity(
        rotation=alignment.site_from_sfm.rotation,
        translation=alignment.site_from_sfm.translation + shift.shift_site_m,
        scale=alignment.site_from_sfm.scale,
    )
    by_edges = ", ".join(
        f"{observability.description} (shifted by {float(observability.direction @ shift.shift_site_m):+.2f} m)"
        for observability in alignment.shifts
        if not observability.observed
    )
    remark = (
        f"determined by the model's edges: {by_edges}; score {shift.score:.2f}, "
        f"best other shift {shift.edge_score_runner_up:.2f}"
    )
    return ModelPlacement(
        site_from_sfm=site_from_sfm,
        alignment=alignment,
        shift=shift,
        remarks=(alignment.remarks[0], remark),
        datum_sigma_m=np.hypot(_WALLS_SIGMA_M, shift.sigma_m * np.sqrt((free_directions**2).sum(axis=0))),
    )


def build_cameras(reconstruction: Reconstruction, site_from_sfm: Similarity) -> tuple[PosedCamera, ...]:
    """The block's cameras, transformed by a similarity."""
    return tuple(
        PosedCamera(
            camera=photo.camera,
            site_from_cam=Similarity(
                rotation=site_from_sfm.rotation @ photo.sfm_from_cam.rotation,
                translation=site_from_sfm.apply(photo.sfm_from_cam.translation),
            ),
        )
        for photo in reconstruction.photos
    )
