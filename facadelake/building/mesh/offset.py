"""Read the offset files of photogrammetry programs: the position of a mesh's origin on the map.

Supported are OpenDroneMap's ``odm_georeferencing_model_geo.txt`` and ``coords.txt`` (a line with the CRS, a line with
east and north), Pix4D's ``*_offset.xyz`` (a line with three numbers), and ``metadata.xml`` of DJI Terra and
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
    """East, north, height of the mesh's origin on the map, as the file gives them; ``crs`` if the file names one."""

    east_m: float
    north_m: float
    height_m: float
    crs: str | None


def read_mesh_offset(path: Path) -> MeshOffset:
    """Read the offset in ``path``. Raises GeoreferenceError if the file is missing or has no offset."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise GeoreferenceError(
            f"the offset file {path} cannot be read ({error}); correct crs.offset_file in the portfolio"
        ) from error
    crs, values = _parse_xml(text) if text.lstrip().startswith("<") else _parse_text(text)
    if len(values) not in (2, 3):
        raise GeoreferenceError(
            f"{path.name} has no offset; expected is a line with east and north (and height), such as "
            "'432000 5422000', after at most one line with the CRS; set crs.placement (east_m, north_m, height_m) in "
            "the portfolio instead"
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
    """The numbers of a line of numbers; empty for any other line."""
    try:
        return [float(token) for token in re.split(r"[\s,;]+", line.strip())]
    except ValueError:
        return []


def _parse_crs(text: str, path: Path) -> str:
    utm = _UTM.match(text)
    if utm:
        return f"EPSG:{326 if utm[2].upper() == 'N' else 327}{int(utm[1]):02d}"
    try:
        code = pyproj.CRS.from_user_input(text).to_epsg()
    except CRSError as error:
        raise GeoreferenceError(
            f"{path.name} names the CRS '{text}', which PROJ does not know; set crs.map and crs.placement in the "
            "portfolio instead"
        ) from error
    return f"EPSG:{code}" if code else text
