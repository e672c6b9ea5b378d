"""The building as the other rooms see it: elements, triangles in site, and where the site lies on the globe."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.building.model_georeference.control_pairs import ControlPair
from facadelake.building.model_georeference.crs import ELLIPSOIDAL
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.building.storeys import StoreyElevation, StoreyLevel
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.errors import ModelError
from facadelake.core.geodesy import SiteOrigin, promote_to_3d
from facadelake.core.tables import read_table, write_table
from schemas.vocabulary import SurfaceKind

SURFACE_FILE = "surface.npz"
_DESCRIPTION_FILE = "building.json"


@dataclass(frozen=True, kw_only=True)
class IfcModelSettings:
    """What the registry says about a building model; None leaves the word to the IFC.

    ``vertical_datum`` is "ellipsoidal" or a vertical CRS such as "EPSG:5783". ``placement`` stands in where the IFC
    has no map conversion, and ``control`` before that: pairs of points of the model and of the map. ``accept_level`` is
    the lowest LoGeoRef to be taken though it is good to metres alone. ``building`` names the one IfcBuilding to take
    (name or GlobalId); empty takes all. ``storeys`` are its storeys where the IFC has none. ``mesh_deflection_m`` bounds
    how far a flat triangle leaves a curved surface.
    """

    map_crs: str | None = None
    vertical_datum: str | None = None
    placement: MapPlacement | None = None
    control: tuple[ControlPair, ...] = ()
    accept_level: int | None = None
    building: str = ""
    storeys: tuple[StoreyElevation, ...] = ()
    origin: SiteOrigin | None = None
    mesh_deflection_m: float = 0.001
    workers: int = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class BuildingModel:
    """A georeferenced building.

    ``vertices_site_m`` (n, 3) float64, ``triangles`` (m, 3) rows of vertices, wound so that normals of closed bodies
    point out; ``element_of_triangle`` (m,) rows of ``elements`` (a table of kind ``elements``).
    ``vertical_datum`` is "ellipsoidal" or an EPSG code; ``georeference_level`` is its LoGeoRef or "registry".
    ``remarks`` says in words what had to be assumed; empty where nothing was. ``storeys`` come from the lowest up.
    ``surface_kind`` says what the surface was made of. ``surface_sigma_m``: how far the surface may stand off the
    building, one sigma, where it was measured with the surface; None leaves that to the registry's tolerance.
    """

    origin: SiteOrigin
    map_crs: str
    vertical_datum: str
    georeference_level: str
    remarks: str
    vertices_site_m: Float64Array
    triangles: Int64Array
    element_of_triangle: Int64Array
    elements: pa.Table
    storeys: tuple[StoreyLevel, ...] = ()
    surface_kind: SurfaceKind = SurfaceKind.IFC
    surface_sigma_m: float | None = None

    @property
    def has_surface(self) -> bool:
        """Whether there is a surface yet; of a building without any model it is made once the campaign is placed."""
        return len(self.triangles) > 0

    @property
    def height_crs(self) -> str:
        """The CRS of map coordinates with height: compound where the vertical datum is not the ellipsoid."""
        if self.vertical_datum == ELLIPSOIDAL:
            return self.map_crs
        return f"{self.map_crs}+{self.vertical_datum.removeprefix('EPSG:')}"

    def map_from_site(self, xyz_site_m: Float64Array) -> Float64Array:
        """Site points (n, 3) as east, north of ``map_crs`` and height of ``vertical_datum``, all in metres."""
        units = [axis.unit_conversion_factor for axis in promote_to_3d(self.height_crs).axis_info]
        metres: Float64Array = self.origin.map_from_site(xyz_site_m, self.height_crs) * np.array(units)
        return metres

    def compute_vertical_extents(self) -> Float64Array:
        """Lowest and highest level (elements, 2) of each element in site."""
        levels = self.vertices_site_m[self.triangles, 2]
        low, high = np.full(len(self.elements), np.inf), np.full(len(self.elements), -np.inf)
        np.minimum.at(low, self.element_of_triangle, levels.min(axis=1))
        np.maximum.at(high, self.element_of_triangle, levels.max(axis=1))
        return np.column_stack([low, high])

    def save(self, folder: Path) -> None:
        """Write the model into ``folder``, for ``read_building``."""
        np.savez(
            folder / SURFACE_FILE,
            vertices_site_m=self.vertices_site_m,
            triangles=self.triangles,
            element_of_triangle=self.element_of_triangle,
        )
        write_table("elements", self.elements, folder)
        place = {
            "origin": asdict(self.origin),
            "map_crs": self.map_crs,
            "vertical_datum": self.vertical_datum,
            "georeference_level": self.georeference_level,
            "remarks": self.remarks,
            "storeys": [asdict(storey) for storey in self.storeys],
            "surface_kind": self.surface_kind,
            "surface_sigma_m": self.surface_sigma_m,
        }
        (folder / _DESCRIPTION_FILE).write_text(json.dumps(place, indent=1))


def read_building(folder: Path) -> BuildingModel:
    """The model that ``BuildingModel.save`` wrote into ``folder``; raises ModelError where there is none."""
    try:
        place = json.loads((folder / _DESCRIPTION_FILE).read_text())
        with np.load(folder / SURFACE_FILE) as arrays:
            vertices, triangles, owner = (
                arrays["vertices_site_m"],
                arrays["triangles"],
                arrays["element_of_triangle"],
            )
    except (OSError, ValueError, KeyError) as error:
        raise ModelError(
            f"no saved building model in {folder} ({error}); delete the folder and run again, it will be made anew"
        ) from error
    return BuildingModel(
        origin=SiteOrigin(**place["origin"]),
        map_crs=place["map_crs"],
        vertical_datum=place["vertical_datum"],
        georeference_level=place["georeference_level"],
        remarks=place["remarks"],
        storeys=tuple(StoreyLevel(**storey) for storey in place["storeys"]),
        surface_kind=SurfaceKind(place.get("surface_kind", SurfaceKind.IFC)),
        surface_sigma_m=place.get("surface_sigma_m"),
        vertices_site_m=vertices,
        triangles=triangles,
        element_of_triangle=owner,
        elements=read_table("elements", folder),
    )
