"""What the registry says of a building without BIM: a mesh file, or nothing but its photographs."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path, PurePath
from urllib.parse import unquote

from schemas.vocabulary import SurfaceKind

AS_BUILT = "as-built"  # stands where a model's path would
_MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf")
UNITS_M = {"metre": 1.0, "millimetre": 0.001, "foot": 0.3048, "us_survey_foot": 1200 / 3937}
_IFC, _MESH, _BARE = SurfaceKind.IFC, SurfaceKind.MESH, SurfaceKind.AS_BUILT
_APPLICABLE_KINDS = {
    "placement": (_IFC, _MESH),
    "control": (_IFC,),
    "accept_level": (_IFC,),
    "offset_file": (_MESH,),
    "axes": (_MESH,),
    "unit": (_MESH,),
    "storeys": (_IFC, _MESH, _BARE),
    "model_building": (_IFC,),
}
_KIND_LABELS = {_IFC: "an IFC", _MESH: "a mesh", _BARE: "'as-built', no model at all"}


def infer_surface_kind(model: str) -> SurfaceKind:
    """What the registry's ``model`` is, by its word or its ending."""
    if model == AS_BUILT:
        return SurfaceKind.AS_BUILT
    return SurfaceKind.MESH if PurePath(model).suffix.lower() in _MESH_SUFFIXES else SurfaceKind.IFC


def find_buffer_files(model: Path) -> tuple[Path, ...]:
    """The files that hold a model's coordinates beside it: the buffers that a glTF in text names, if they are there."""
    if model.suffix.lower() != ".gltf":
        return ()
    try:
        names = [buffer.get("uri", "") for buffer in json.loads(model.read_text(encoding="utf-8"))["buffers"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return ()  # the mesh's reader says what is wrong with it
    beside = [model.parent / unquote(name) for name in names if name and not name.startswith("data:")]
    return tuple(path for path in beside if path.is_file())


def require_applicable_keys(model: str, given: Collection[str]) -> None:
    """Raise ValueError where a key that is ``given`` says nothing of such a model, or one that it needs is not."""
    kind = infer_surface_kind(model)
    for key in given:
        if key in _APPLICABLE_KINDS and kind not in _APPLICABLE_KINDS[key]:
            allowed = " or ".join(_KIND_LABELS[one] for one in _APPLICABLE_KINDS[key])
            raise ValueError(f"'{key}' is for a building whose model is {allowed}; this one's is {_KIND_LABELS[kind]}")
    if "placement" in given and "offset_file" in given:
        raise ValueError("both 'placement' and 'offset_file' place the mesh; give one of them")
    if kind is SurfaceKind.AS_BUILT and "vertical" not in given:
        raise ValueError(
            "'vertical' is missing in 'crs': without a model nothing else says what heights refer to; give "
            "'ellipsoidal', or a vertical CRS such as EPSG:7837"
        )
