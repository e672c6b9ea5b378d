"""The building's model as control of a block: its surface, and its edges as the photographs show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import ModelEdges, Surface, extract_model_edges
from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface
from facadelake.georeferencing.gps.alignment import align_to_gps
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.model.alignment import ModelAlignment, align_to_model
from facadelake.georeferencing.model.edge_search import EdgeShift, search_shift
from facadelake.georeferencing.model.gradients import GreyFiles
from facadelake.sfm import Reconstruction
from schemas.vocabulary import SurfaceKind

# Heights without a datum may be off by the geoid; the search begins at plausible heights and goes this far around.
_SEARCH_SIGMA_M = 5.0
# What a similarity to walls leaves of the datum, for the adjustment to better.
_WALLS_SIGMA_M = 0.05
# A mesh of more was measured: its creases are its roughness, not the building's edges.
_MAX_DESIGNED_TRIANGLES = 50_000


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelEdgeControl:
    """The model's edges and the photographs that may show them, in the order of the block's photographs."""

    edges: ModelEdges
    surface: Surface
    photographs: GreyFiles

    def find_shift(self, cameras: Sequence[PosedCamera], free: Float64Array, sigma_m: Float64Array) -> EdgeShift:
        """Where along ``free`` (j, 3) the edges meet the photographs; see ``edge_search.find_shift``."""
        return search_shift(cameras, self.photographs, self.edges, self.surface, free, sigma_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelControl:
    """What of the model can hold a block.

    ``sigma_m``: how far the building may stand off its model; ``ground_site_m``: the model's lowest level, where
    drones take off; ``edges`` None where there are none to look for, as on a mesh that was itself measured.
    """

    surface: RaySurface
    sigma_m: float
    ground_site_m: float
    edges: ModelEdgeControl | None = None


def build_model_control(building: BuildingModel, photographs: Sequence[Path], sigma_m: float) -> ModelControl:
    """The control that ``building`` gives to the block of ``photographs`` (in the block's order)."""
    surface = Surface(building)
    rough = building.surface_kind is not SurfaceKind.IFC and len(building.triangles) > _MAX_DESIGNED_TRIANGLES
    return ModelControl(
        surface=surface,
        sigma_m=sigma_m,
        ground_site_m=float(building.vertices_site_m[:, 2].min()),
        edges=None if rough else _build_edge_control(building, surface, photographs),
    )


def _build_edge_control(building: BuildingModel, surface: Surface, photographs: Sequence[Path]) -> ModelEdgeControl:
    edges = extract_model_edges(building.vertices_site_m, building.triangles, building.element_of_triangle)
    return ModelEdgeControl(edges=edges, surface=surface, photographs=GreyFiles(paths=tuple(photographs)))


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelPlacement:
    """A start by the model: walls first, then edges along what walls leave open.

    ``shift`` is None where the walls observed everything, or no photographs could be looked at.
    ``datum_sigma_m`` (3,): how well walls and edges together place the block, the edges by how they agree with one
    another; None where a direction is left to GPS.
    """

    site_from_sfm: Similarity
    alignment: ModelAlignment
    shift: EdgeShift | None
    datum_sigma_m: Float64Array | None
    remarks: tuple[str, ...]


def place_by_model(reconstruction: Reconstruction, priors: GpsPriors, model: ModelControl) -> ModelPlacement:
    """Similarity of the block to the model, from GPS on.

    Where heights name no datum, the take-off on the model's lowest level is a second start; the one whose edges meet
    the photographs better is taken. Raises GeoreferenceError where the walls are not met, or two shifts compete.
    """
    by_gps = align_to_gps(reconstruction, priors)
    found: list[ModelPlacement] = []
    problems: list[GeoreferenceError] = []
    for lift_m in _list_height_corrections(priors, model.ground_site_m):
        lifted = priors.shift_height(lift_m)
        start = Similarity(
            rotation=by_gps.site_from_sfm.rotation,
            translation=by_gps.site_from_sfm.translation + np.array([0.0, 0.0, lift_m]),
            scale=by_gps.site_from_sfm.scale,
        )
        try:
            found.append(_place_from(start, reconstruction, lifted, model))
        except GeoreferenceError as error:
            problems.append(error)
    if not found:
        raise problems[0]
    return max(found, key=lambda placement: placement.shift.score if placement.shift is not None else 0.0)


def _list_height_corrections(priors: GpsPriors, ground_site_m: float) -> list[float]:
    """What to add to the priors' heights: nothing, and, where their datum is unknown and they tell their height above
    the take-off, what puts the take-off on the ground."""
    relative = priors.height_relative_m
    known = np.isfinite(relative)
    if not priors.datum_unknown or known.sum() < 3:
        return [0.0]
    lift_m = float(np.median(ground_site_m + relative[known] - priors.xyz_site_m[known, 2]))
    return [0.0] if abs(lift_m) < _SEARCH_SIGMA_M else [0.0, lift_m]


def _place_from(
    start: Similarity, reconstruction: Reconstruction, priors: GpsPriors, model: ModelControl
) -> ModelPlacement:
    walls = align_to_model(start, reconstruction, priors, model.surface)
    free = np.array([shift.direction for shift in walls.shifts if not shift.observed]).reshape(-1, 3)
    if not len(free) or model.edges is None:
        return ModelPlacement(
            site_from_sfm=walls.site_from_sfm,
            alignment=walls,
            shift=None,
            datum_sigma_m=None if len(free) else np.full(3, _WALLS_SIGMA_M),
            remarks=walls.remarks,
        )
    sigma_m = np.linalg.norm(np.minimum(priors.common_sigma_m, _SEARCH_SIGMA_M) * free, axis=1)
    shift = model.edges.find_shift(build_cameras(reconstruction, walls.site_from_sfm), free, sigma_m)
    moved = Similarity(
        rotation=walls.site_from_sfm.rotation,
        translation=walls.site_from_sfm.translation + shift.shift_site_m,
        scale=walls.site_from_sfm.scale,
    )
    by_edges = ", ".join(
        f"{observed.description} (moved by {float(observed.direction @ shift.shift_site_m):+.2f} m)"
        for observed in walls.shifts
        if not observed.observed
    )
    remark = (
        f"found by the model's edges: {by_edges}; score {shift.score:.2f}, "
        f"best other shift {shift.edge_score_runner_up:.2f}"
    )
    return ModelPlacement(
        site_from_sfm=moved,
        alignment=walls,
        shift=shift,
        remarks=(walls.remarks[0], remark),
        datum_sigma_m=np.hypot(_WALLS_SIGMA_M, shift.sigma_m * np.sqrt((free**2).sum(axis=0))),
    )


def build_cameras(reconstruction: Reconstruction, site_from_sfm: Similarity) -> tuple[PosedCamera, ...]:
    """The block's cameras under a similarity."""
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
