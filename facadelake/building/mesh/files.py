"""A mesh file (OBJ, PLY, STL, glTF) as triangles in metres with z up, and how exact its coordinates can be."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import trimesh

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.errors import ModelError

_log = logging.getLogger(__name__)

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf")
_MAX_SPACING_M = 0.001  # coordinates kept more coarsely than this move walls by what registration measures
_MIN_VERTICES = 100  # so many coordinates are not all on the grid of float32 by chance
_MAX_SIZE_M = 5_000.0
_MIN_SIZE_M = 1.0
_MAX_TRIANGLES = 20_000_000
_MIN_TRIANGLE_M2 = 1e-10


class MeshAxes(StrEnum):
    """Which axis of the file is up."""

    Z_UP = "z-up"
    Y_UP = "y-up"


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshFile:
    """``vertices_m`` (n, 3) float64, z up, in the file's own origin; ``triangles`` (m, 3) rows of vertices.

    ``resolution_m`` is the coarsest step between the coordinates that the file's number format can hold.
    """

    vertices_m: Float64Array
    triangles: Int64Array
    resolution_m: float


def read_mesh_file(path: Path, *, axes: MeshAxes | None = None, unit_m: float = 1.0) -> MeshFile:
    """The mesh at ``path``, all its parts together; textures, colours and normals are left aside.

    ``axes`` None: y up for glTF, as its standard has it, z up for the others. ``unit_m``: metres of the file's unit.
    Raises ModelError for a file that is missing, unreadable, without triangles, with coordinates that are no numbers
    or too coarse, or of a size that no building has.
    """
    if not path.is_file():
        raise ModelError(f"the mesh {path} does not exist; correct the registry's model")
    vertices, triangles, step = _load_parts(path)
    if len(triangles) == 0:
        raise ModelError(f"{path.name} holds no triangles (a point cloud?); export a mesh with faces")
    if len(triangles) > _MAX_TRIANGLES:
        raise ModelError(
            f"{path.name} has {len(triangles):,} triangles, more than {_MAX_TRIANGLES:,}; reduce the mesh (decimate), "
            "or cut it down to the building"
        )
    used, renumbered = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], renumbered.reshape(-1, 3).astype(np.int64)
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise ModelError(
            f"{path.name}: {int(bad.sum())} of {len(vertices)} vertices are not numbers (NaN or infinite); "
            "repair the mesh, or export it anew"
        )
    step_m = max(step, _detect_float32_spacing(vertices) if len(vertices) > _MIN_VERTICES else 0.0) * unit_m
    vertices = vertices * unit_m
    _check_size(path, vertices, unit_m)
    if step_m > _MAX_SPACING_M:
        raise ModelError(
            f"{path.name} keeps its coordinates as 32-bit numbers, which at {np.abs(vertices).max():,.0f} m come in "
            f"steps of {1000 * step_m:.0f} mm (limit {1000 * _MAX_SPACING_M:.0f} mm): the mesh's detail is gone; export "
            "it with an offset (coordinates near zero) and give that as the registry's crs.offset_file or "
            "crs.placement, or as OBJ or double-precision PLY with all digits"
        )
    axes = axes or (MeshAxes.Y_UP if path.suffix.lower() in (".glb", ".gltf") else MeshAxes.Z_UP)
    if axes is MeshAxes.Y_UP:  # x right, y up, z to the viewer
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    if not (area > _MIN_TRIANGLE_M2).any():
        raise ModelError(f"{path.name}: all {len(triangles)} triangles are without area; export the mesh anew")
    triangles = triangles[area > _MIN_TRIANGLE_M2]
    _log.info("%s: %d triangles", path.name, len(triangles))
    return MeshFile(vertices_m=vertices, triangles=triangles, resolution_m=step_m)


def _load_parts(path: Path) -> tuple[Float64Array, Int64Array, float]:
    """Vertices and triangles of all parts in the file's unit, and the step of its numbers."""
    try:
        scene = trimesh.load_scene(path, process=False, maintain_order=True, skip_materials=True)
        narrow = _is_float32(path)
        vertices: list[Float64Array] = []
        triangles: list[Int64Array] = []
        step, count = 0.0, 0
        for name in sorted(scene.graph.nodes_geometry):
            placed, geometry = scene.graph[name]
            part = scene.geometry[geometry]
            if not isinstance(part, trimesh.Trimesh) or len(part.faces) == 0:
                continue
            own = np.asarray(part.vertices, dtype=np.float64)
            moved = own @ np.asarray(placed)[:3, :3].T + np.asarray(placed)[:3, 3]
            if narrow:  # a glTF node's own offset is kept in 64 bits: only what stands in the buffers is coarse
                step = max(step, float(np.spacing(np.float32(np.nanmax(np.abs(own))))))
            faces = np.asarray(part.faces, dtype=np.int64)
            if faces.min() < 0 or faces.max() >= len(own):
                raise ModelError(f"{path.name}: a face names vertex {faces.max()} of {len(own)}; export the mesh anew")
            vertices.append(moved)
            triangles.append(faces + count)
            count += len(own)
    except ModelError:
        raise
    except Exception as error:  # the readers raise whatever strangers' bytes lead them to
        raise ModelError(
            f"{path.name} cannot be read as a mesh ({type(error).__name__}: {error}); is it whole, and is its ending "
            f"that of its format ({', '.join(MESH_SUFFIXES)})? Compressed glTF (Draco, meshopt) is not read"
        ) from error
    if not triangles:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), 0.0
    return np.vstack(vertices), np.vstack(triangles), step


def _is_float32(path: Path) -> bool:
    """Whether the format, or the PLY's header, keeps coordinates in 32 bits."""
    suffix = path.suffix.lower()
    if suffix == ".ply":
        head = path.open("rb").read(65_536).split(b"end_header")[0]
        return b"property float x" in head or b"property float32 x" in head
    if suffix == ".stl":
        return b"facet" not in path.open("rb").read(1_024)
    return suffix in (".glb", ".gltf")


def _detect_float32_spacing(vertices: Float64Array) -> float:
    """The step of 32-bit numbers along the axes on which all coordinates are such numbers; 0 where on none.

    A program that held large coordinates in 32 bits has lost them, in however many digits it then wrote them.
    """
    largest = np.abs(vertices).max(axis=0).astype(np.float32)
    narrow = (vertices == vertices.astype(np.float32)).all(axis=0)
    return float(np.where(narrow, np.spacing(largest), 0.0).max())


def _check_size(path: Path, vertices: Float64Array, unit_m: float) -> None:
    size_m = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    if not _MIN_SIZE_M <= size_m <= _MAX_SIZE_M:
        raise ModelError(
            f"{path.name} is {size_m:,.6g} m across (a building is {_MIN_SIZE_M:.0f} to {_MAX_SIZE_M:,.0f} m) when its "
            f"unit is taken as {unit_m} m; give the registry's crs.unit (metre, millimetre, foot, us_survey_foot), "
            "or cut the mesh down to the building"
        )
