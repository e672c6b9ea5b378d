"""Read a mesh file (OBJ, PLY, STL, glTF) as triangles in metres with z up, and check the spacing of its numbers."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import trimesh

from facadelake.core.arrays import Float64Nx3, Int64Nx3
from facadelake.core.errors import ModelError
from facadelake.registry import UNITS_M

_log = logging.getLogger(__name__)

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf")
_MAX_SPACING_M = 0.001  # a coarser spacing of coordinates moves walls by as much as registration resolves
_MIN_VERTICES = 100  # this many coordinates are not all representable in float32 by chance
MAX_SIZE_M = 5_000.0
_MIN_SIZE_M = 1.0
_MAX_TRIANGLES = 20_000_000
_MIN_TRIANGLE_M2 = 1e-10


class MeshAxes(StrEnum):
    """Which axis of the file is up."""

    Z_UP = "z-up"
    Y_UP = "y-up"


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshFile:
    """``vertices_m`` (n, 3), z up, relative to the file's origin; ``triangles`` (m, 3) rows of vertices.

    ``axes`` is the reading of the file's axes.
    """

    vertices_m: Float64Nx3
    triangles: Int64Nx3
    axes: MeshAxes


def read_mesh_file(path: Path, *, axes: MeshAxes | None = None, unit_m: float = 1.0) -> MeshFile:
    """Read all parts of the mesh at ``path`` as one mesh; textures, colours and normals are ignored.

    ``axes`` None: y up for glTF, as its standard defines, z up for the others. ``unit_m``: metres per unit of the file.
    Raises ModelError for a file that is missing, unreadable, without triangles, with coordinates that are not finite
    or too coarse, or of a size that no building has.
    """
    if not path.is_file():
        raise ModelError(f"the mesh {path} does not exist; correct model in the portfolio")
    vertices, triangles, spacing = _load_parts(path)
    if len(triangles) == 0:
        raise ModelError(f"{path.name} has no triangles (a point cloud?); export a mesh with faces")
    if len(triangles) > _MAX_TRIANGLES:
        raise ModelError(
            f"{path.name} has {len(triangles):,} triangles, limit {_MAX_TRIANGLES:,}; simplify (decimate) the mesh, or "
            "crop it to the building"
        )
    used, renumbered = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], renumbered.reshape(-1, 3).astype(np.int64)
    not_finite = ~np.isfinite(vertices).all(axis=1)
    if not_finite.any():
        raise ModelError(
            f"{path.name}: {int(not_finite.sum())} of {len(vertices)} vertices are not finite (NaN or infinite); "
            "repair the mesh, or export it again"
        )
    spacing_m = max(spacing, _detect_float32_spacing(vertices) if len(vertices) > _MIN_VERTICES else 0.0) * unit_m
    vertices = vertices * unit_m
    _check_size(path, vertices, unit_m)
    if spacing_m > _MAX_SPACING_M:
        raise ModelError(
            f"{path.name} stores its coordinates as 32-bit numbers, whose spacing at {np.abs(vertices).max():,.0f} m "
            f"is {1000 * spacing_m:.0f} mm (limit {1000 * _MAX_SPACING_M:.0f} mm), so the mesh's detail is lost; "
            "export it with an offset (coordinates near zero) and set crs.offset_file or crs.placement in the "
            "portfolio, or export OBJ or double-precision PLY with all digits"
        )
    axes = axes or (MeshAxes.Y_UP if path.suffix.lower() in (".glb", ".gltf") else MeshAxes.Z_UP)
    if axes is MeshAxes.Y_UP:
        vertices = turn_y_up(vertices)
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    if not (area > _MIN_TRIANGLE_M2).any():
        raise ModelError(f"{path.name}: all {len(triangles)} triangles have zero area; export the mesh again")
    triangles = triangles[area > _MIN_TRIANGLE_M2]
    _log.info("%s: %d triangles", path.name, len(triangles))
    return MeshFile(vertices_m=vertices, triangles=triangles, axes=axes)


def turn_y_up(vertices: Float64Nx3) -> Float64Nx3:
    """Vertices (n, 3) with y up (x right, z towards the viewer) as vertices with z up."""
    turned: Float64Nx3 = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
    return turned


def turn_z_up(vertices: Float64Nx3) -> Float64Nx3:
    """The inverse of ``turn_y_up``: what a file with z up has where it was read with y up."""
    turned: Float64Nx3 = vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    return turned


def _load_parts(path: Path) -> tuple[Float64Nx3, Int64Nx3, float]:
    """Vertices and triangles of all parts in the file's unit, and the spacing of its numbers."""
    try:
        scene = trimesh.load_scene(path, process=False, maintain_order=True, skip_materials=True)
        is_float32 = _is_float32(path)
        vertices: list[Float64Nx3] = []
        triangles: list[Int64Nx3] = []
        spacing, count = 0.0, 0
        for name in sorted(scene.graph.nodes_geometry):
            matrix, geometry = scene.graph[name]
            part = scene.geometry[geometry]
            if not isinstance(part, trimesh.Trimesh) or len(part.faces) == 0:
                continue
            local = np.asarray(part.vertices, dtype=np.float64)
            in_scene = local @ np.asarray(matrix)[:3, :3].T + np.asarray(matrix)[:3, 3]
            if is_float32:  # the offset of a glTF node is stored in 64 bits: only the buffers are coarse
                spacing = max(spacing, float(np.spacing(np.float32(np.nanmax(np.abs(local))))))
            faces = np.asarray(part.faces, dtype=np.int64)
            if faces.min() < 0 or faces.max() >= len(local):
                raise ModelError(
                    f"{path.name}: a face refers to vertex {faces.max()} of {len(local)}; export the mesh again"
                )
            vertices.append(in_scene)
            triangles.append(faces + count)
            count += len(local)
    except ModelError:
        raise
    except Exception as error:  # on malformed files trimesh's readers raise exceptions of any kind
        raise ModelError(
            f"{path.name} cannot be read as a mesh ({type(error).__name__}: {error}); check that the file is complete "
            f"and that its suffix is that of its format ({', '.join(MESH_SUFFIXES)}). Compressed glTF (Draco, meshopt) "
            "is not supported"
        ) from error
    if not triangles:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), 0.0
    return np.vstack(vertices), np.vstack(triangles), spacing


def _is_float32(path: Path) -> bool:
    """Whether the format, or the PLY's header, stores coordinates in 32 bits."""
    suffix = path.suffix.lower()
    if suffix == ".ply":
        head = path.open("rb").read(65_536).split(b"end_header")[0]
        return b"property float x" in head or b"property float32 x" in head
    if suffix == ".stl":
        return b"facet" not in path.open("rb").read(1_024)
    return suffix in (".glb", ".gltf")


def _detect_float32_spacing(vertices: Float64Nx3) -> float:
    """Spacing of 32-bit numbers along the axes on which all coordinates are such numbers; 0 if on none.

    A program that computed large coordinates in 32 bits has rounded them, however many digits it wrote.
    """
    largest = np.abs(vertices).max(axis=0).astype(np.float32)
    is_float32 = (vertices == vertices.astype(np.float32)).all(axis=0)
    return float(np.where(is_float32, np.spacing(largest), 0.0).max())


def _check_size(path: Path, vertices: Float64Nx3, unit_m: float) -> None:
    size_m = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    if not _MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        raise ModelError(
            f"{path.name} is {size_m:,.6g} m across with a unit of {unit_m} m (a building has {_MIN_SIZE_M:.0f} to "
            f"{MAX_SIZE_M:,.0f} m); set crs.unit in the portfolio ({', '.join(UNITS_M)}), or crop "
            "the mesh to the building"
        )
