"""Offset files beside photogrammetry's meshes: where on the map the mesh's zero lies.

Read are OpenDroneMap's ``odm_georeferencing_model_geo.txt`` and ``coords.txt`` (a line with the CRS, a line with east
and north), Pix4D's ``*_offset.xyz`` (a line with three numbers), and the ``metadata.xml`` of DJI Terra and
ContextCapture (SRS and SRSOrigin).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import defusedxml.ElementTree as ElementTree
import pyproj
from pyproj.exceptions import CRSError

from facadelake.core.errors import GeoreferenceError

_UTM = re.compile(r"^WGS\s?84\s+UTM\s+(\d{1,2})\s*([NS])$", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class MeshOffset:
    """East, north, height of the mesh's zero in metres of the map; ``crs`` where the file names one."""

    east_m: float
    north_m: float
    height_m: float
    crs: str | None


def read_mesh_offset(path: Path) -> MeshOffset:
    """The offset in ``path``. Raises GeoreferenceError where the file is missing or says no offset."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise GeoreferenceError(
            f"the offset file {path} cannot be read ({error}); correct the registry's crs.offset_file"
        ) from error
    crs, values = _parse_xml(text) if text.lstrip().startswith("<") else _parse_text(text)
    if len(values) not in (2, 3):
        raise GeoreferenceError(
            f"{path.name} says no offset: a line with east and north (and height) is wanted, such as '432000 5422000', "
            "below at most one line with the CRS; give the registry's crs.placement (east_m, north_m, height_m) instead"
        )
    east, north, height = (*values, 0.0)[:3]
    return MeshOffset(east_m=east, north_m=north, height_m=height, crs=_parse_crs(crs, path) if crs else None)


def _parse_text(text: str) -> tuple[str, list[float]]:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    crs = lines.pop(0) if lines and not _parse_numbers(lines[0]) else ""
    return crs, _parse_numbers(lines[0]) if lines else []


def _parse_xml(text: str) -> tuple[str, list[float]]:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return "", []
    return (root.findtext("SRS") or "").strip(), _parse_numbers(root.findtext("SRSOrigin") or "")


def _parse_numbers(line: str) -> list[float]:
    """The numbers of a line that holds nothing else; empty otherwise."""
    try:
        return [float(word) for word in re.split(r"[\s,;]+", line.strip())]
    except ValueError:
        return []


def _parse_crs(words: str, path: Path) -> str:
    utm = _UTM.match(words)
    if utm:
        return f"EPSG:{326 if utm[2].upper() == 'N' else 327}{int(utm[1]):02d}"
    try:
        code = pyproj.CRS.from_user_input(words).to_epsg()
    except CRSError as error:
        raise GeoreferenceError(
            f"{path.name} names the CRS '{words}', which PROJ does not know; give the registry's crs.map and "
            "crs.placement instead"
        ) from error
    return f"EPSG:{code}" if code else words
