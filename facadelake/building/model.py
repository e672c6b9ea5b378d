"""The building model that other packages use: elements, surface triangles in site, site origin and map CRS."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.building.storeys import StoreyLevel
from facadelake.core.arrays import BoolArray, Float64Nx2, Float64Nx3, Int64Nx3, RowIndices
from facadelake.core.errors import ModelError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.proj.crs import combine_crs, promote_to_3d
from facadelake.core.tables import read_table, write_table
from schemas.vocabulary import SurfaceKind

SURFACE_FILE = "surface.npz"
_DESCRIPTION_FILE = "building.json"
# Classes that an IFC holds beside the building: ground, plants, furniture, signs and vehicles.
_NON_TARGET_CLASSES = frozenset(
    {
        "IfcSite",
        "IfcGeographicElement",
        "IfcEarthworksElement",
        "IfcEarthworksFill",
        "IfcEarthworksCut",
        "IfcPavement",
        "IfcKerb",
        "IfcCourse",
        "IfcSign",
        "IfcVehicle",
        "IfcFurnishingElement",
        "IfcFurniture",
        "IfcSystemFurnitureElement",
    }
)


@dataclass(frozen=True, kw_only=True, eq=False)
class BuildingModel:
    """A georeferenced building.

    ``vertices_site_m`` (n, 3) and ``triangles`` (m, 3, rows of the vertices) are the surface in site; triangles of
    closed bodies are wound so that normals point outward. ``element_of_triangle`` (m,) holds rows of ``elements``, a
    table of kind ``elements``. ``vertical_datum`` is "ellipsoidal" or an EPSG code; ``georeference_level`` is the
    LoGeoRef level or "registry". ``remarks`` lists the assumptions made, empty if none. ``storeys`` are sorted by
    level. ``surface_sigma_m`` is the standard deviation of the surface from the real building where it was estimated
    with the surface; None means that the portfolio's tolerance applies.
    """

    origin: SiteOrigin
    map_crs: str
    vertical_datum: str
    georeference_level: str
    remarks: str
    vertices_site_m: Float64Nx3
    triangles: Int64Nx3
    element_of_triangle: RowIndices
    elements: pa.Table
    storeys: tuple[StoreyLevel, ...] = ()
    surface_kind: SurfaceKind = SurfaceKind.IFC
    surface_sigma_m: float | None = None

    @property
    def has_surface(self) -> bool:
        """Whether the model has triangles; without a model file the surface is built after georeferencing."""
        return len(self.triangles) > 0

    @property
    def height_crs(self) -> str:
        """The CRS of map coordinates with height; compound unless heights are ellipsoidal."""
        return combine_crs(self.map_crs, self.vertical_datum)

    def map_from_site(self, xyz_site_m: Float64Nx3) -> Float64Nx3:
        """Transform site points (n, 3) to east, north of ``map_crs`` and height of ``vertical_datum``, in metres."""
        units = [axis.unit_conversion_factor for axis in promote_to_3d(self.height_crs).axis_info]
        metres: Float64Nx3 = self.origin.map_from_site(xyz_site_m, self.height_crs) * np.array(units)
        return metres

    def compute_vertical_extents(self) -> Float64Nx2:
        """Lowest and highest z in site, metres, of each element (elements, 2)."""
        levels = self.vertices_site_m[self.triangles, 2]
        low, high = np.full(len(self.elements), np.inf), np.full(len(self.elements), -np.inf)
        np.minimum.at(low, self.element_of_triangle, levels.min(axis=1))
        np.maximum.at(high, self.element_of_triangle, levels.max(axis=1))
        return np.column_stack([low, high])

    def save(self, folder: Path) -> None:
        """Write the model into ``folder``; ``read_building`` reads it."""
        np.savez(
            folder / SURFACE_FILE,
            vertices_site_m=self.vertices_site_m,
            triangles=self.triangles,
            element_of_triangle=self.element_of_triangle,
        )
        write_table("elements", self.elements, folder)
        description = {
            "origin": asdict(self.origin),
            "map_crs": self.map_crs,
            "vertical_datum": self.vertical_datum,
            "georeference_level": self.georeference_level,
            "remarks": self.remarks,
            "storeys": [asdict(storey) for storey in self.storeys],
            "surface_kind": self.surface_kind,
            "surface_sigma_m": self.surface_sigma_m,
        }
        (folder / _DESCRIPTION_FILE).write_text(json.dumps(description, indent=1))


def read_building(folder: Path) -> BuildingModel:
    """Read the model that ``BuildingModel.save`` wrote into ``folder``. Raises ModelError if there is none."""
    try:
        description = json.loads((folder / _DESCRIPTION_FILE).read_text())
        with np.load(folder / SURFACE_FILE) as arrays:
            vertices, triangles, element_of_triangle = (
                arrays["vertices_site_m"],
                arrays["triangles"],
                arrays["element_of_triangle"],
            )
    except (OSError, ValueError, KeyError) as error:
        raise ModelError(
            f"no saved building model in {folder} ({error}); delete the folder and run again to rebuild it"
        ) from error
    return BuildingModel(
        origin=SiteOrigin(**description["origin"]),
        map_crs=description["map_crs"],
        vertical_datum=description["vertical_datum"],
        georeference_level=description["georeference_level"],
        remarks=description["remarks"],
        storeys=tuple(StoreyLevel(**storey) for storey in description["storeys"]),
        surface_kind=SurfaceKind(description.get("surface_kind", SurfaceKind.IFC)),
        surface_sigma_m=description.get("surface_sigma_m"),
        vertices_site_m=vertices,
        triangles=triangles,
        element_of_triangle=element_of_triangle,
        elements=read_table("elements", folder),
    )


def mask_target_elements(elements: pa.Table) -> BoolArray:
    """Mask (n,) of the rows of table ``elements`` that are parts of the building, on which a defect can be."""
    return np.array([name not in _NON_TARGET_CLASSES for name in elements.column("ifc_class").to_pylist()], dtype=bool)
