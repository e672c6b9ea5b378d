"""Kinds of building surface: an IFC, a mesh, or none but the as-built surface; and the portfolio keys of each."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path, PurePath
from urllib.parse import unquote

from schemas.vocabulary import SurfaceKind

AS_BUILT = "as-built"  # keyword in place of the path of a model
_IFC_SUFFIX = ".ifc"
_MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf")
UNITS_M = {
    "metre": 1.0,
    "centimetre": 0.01,
    "millimetre": 0.001,
    "inch": 0.0254,
    "foot": 0.3048,
    "us_survey_foot": 1200 / 3937,
}
_IFC, _MESH, _AS_BUILT = SurfaceKind.IFC, SurfaceKind.MESH, SurfaceKind.AS_BUILT
_APPLICABLE_KINDS = {
    "placement": (_IFC, _MESH),
    "control": (_IFC,),
    "accept_level": (_IFC,),
    "map_unit": (_IFC,),
    "offset_file": (_MESH,),
    "axes": (_MESH,),
    "unit": (_MESH,),
    "storeys": (_IFC, _MESH, _AS_BUILT),
    "model_building": (_IFC,),
}
_KIND_LABELS = {_IFC: "an IFC", _MESH: "a mesh", _AS_BUILT: "'as-built' (no model)"}


def infer_surface_kind(model: str) -> SurfaceKind:
    """The kind of surface of a ``model`` in the portfolio, by keyword or file suffix. Raises ValueError for others."""
    if model == AS_BUILT:
        return SurfaceKind.AS_BUILT
    suffix = PurePath(model).suffix.lower()
    if suffix in _MESH_SUFFIXES:
        return SurfaceKind.MESH
    if suffix == _IFC_SUFFIX:
        return SurfaceKind.IFC
    raise ValueError(
        f"the model '{model}' is of no known kind; allowed are an IFC ({_IFC_SUFFIX}, not zipped), a mesh "
        f"({', '.join(_MESH_SUFFIXES)}), and the keyword '{AS_BUILT}' for none"
    )


def find_buffer_files(model: Path) -> tuple[Path, ...]:
    """The existing buffer files of a glTF model in text form, which contain its coordinates; empty for other models."""
    if model.suffix.lower() != ".gltf":
        return ()
    try:
        names = [buffer.get("uri", "") for buffer in json.loads(model.read_text(encoding="utf-8"))["buffers"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return ()  # the reader of the mesh reports the error
    paths = [model.parent / unquote(name) for name in names if name and not name.startswith("data:")]
    return tuple(path for path in paths if path.is_file())


def require_applicable_keys(model: str, given: Collection[str]) -> None:
    """Raise ValueError where a ``given`` key does not apply to this kind of model, or a required key is missing."""
    kind = infer_surface_kind(model)
    for key in given:
        if key in _APPLICABLE_KINDS and kind not in _APPLICABLE_KINDS[key]:
            allowed = " or ".join(_KIND_LABELS[applicable] for applicable in _APPLICABLE_KINDS[key])
            raise ValueError(
                f"'{key}' applies to buildings whose model is {allowed}; the model of this one is {_KIND_LABELS[kind]}"
            )
    if "placement" in given and "offset_file" in given:
        raise ValueError("both 'placement' and 'offset_file' place the mesh; give one of them")
    if kind is SurfaceKind.AS_BUILT and "vertical" not in given:
        raise ValueError(
            "'vertical' is missing in 'crs': without a model the height datum must be given; write 'ellipsoidal', or a "
            "vertical CRS such as EPSG:7837"
        )
