"""The building model as control of a block: its surface, and its edges in the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.building import BuildingModel, SurfaceReading, mask_target_elements
from facadelake.building.surface import ModelEdges, Surface, extract_model_edges
from facadelake.core.arrays import Float64N, Float64Nx3
from facadelake.core.camera import PosedCamera
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface
from facadelake.georeferencing.model.edge_search import EdgeShift, search_shift
from facadelake.georeferencing.model.gradients import GreyFiles
from schemas.vocabulary import SurfaceKind

# A mesh of more triangles was measured: its creases are noise, not the building's edges.
_MAX_DESIGNED_TRIANGLES = 50_000


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelEdgeControl:
    """The model's edges and the photographs that may show them, in the order of the block's photographs."""

    edges: ModelEdges
    surface: Surface
    photographs: GreyFiles

    def search_shift(self, cameras: Sequence[PosedCamera], free_directions: Float64Nx3, sigma_m: Float64N) -> EdgeShift:
        """The shift along ``free_directions`` (j, 3) at which the edges fit the photographs; ``edge_search`` has it."""
        return search_shift(cameras, self.photographs, self.edges, self.surface, free_directions, sigma_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelControl:
    """The parts of the model that can control a block.

    ``sigma_m``: one sigma of the building's deviation from its model; ``ground_site_m``: the model's lowest level,
    where drones take off; ``highest_site_m``: its highest point; ``edges``: None where none are searched, as on a mesh
    that was itself measured; ``building_surface``: the surface without terrain, furniture and vehicles, which may stand
    elsewhere than the building by more than its sigma (None: the surface has none); ``readings``: the surfaces of a
    mesh whose axis or unit the portfolio leaves open, the one taken first.
    """

    surface: RaySurface
    sigma_m: float
    ground_site_m: float
    highest_site_m: float
    edges: ModelEdgeControl | None = None
    building_surface: RaySurface | None = None
    readings: Sequence[SurfaceReading] = ()


def build_model_control(
    building: BuildingModel,
    photographs: Sequence[Path],
    sigma_m: float,
    readings: Sequence[SurfaceReading] = (),
) -> ModelControl:
    """The control that a building gives to a block.

    Args:
        building: the building.
        photographs: the files of the block's photographs, in its order.
        sigma_m: one sigma of the building's deviation from its model.
        readings: the surfaces of a mesh whose axis or unit the portfolio leaves open, the one taken first.

    Returns:
        the control.

    Raises:
        ModelError: the model has no surface.
    """
    surface = Surface(building)
    measured = building.surface_kind is not SurfaceKind.IFC and len(building.triangles) > _MAX_DESIGNED_TRIANGLES
    return ModelControl(
        surface=surface,
        sigma_m=sigma_m,
        ground_site_m=float(building.vertices_site_m[:, 2].min()),
        highest_site_m=float(building.vertices_site_m[:, 2].max()),
        edges=None if measured else _build_edge_control(building, surface, photographs),
        building_surface=build_target_surface(building),
        readings=readings,
    )


def build_target_surface(building: BuildingModel) -> Surface | None:
    """The surface of the elements that are parts of the building; None where that is all, or nothing, of the model."""
    is_target = mask_target_elements(building.elements)[building.element_of_triangle]
    if is_target.all() or not is_target.any():
        return None
    return Surface.from_mesh(
        building.vertices_site_m, building.triangles[is_target], building.element_of_triangle[is_target]
    )


def _build_edge_control(building: BuildingModel, surface: Surface, photographs: Sequence[Path]) -> ModelEdgeControl:
    edges = extract_model_edges(building.vertices_site_m, building.triangles, building.element_of_triangle)
    return ModelEdgeControl(edges=edges, surface=surface, photographs=GreyFiles(paths=tuple(photographs)))
