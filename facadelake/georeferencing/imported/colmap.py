"""COLMAP's text files: cameras.txt, images.txt, and ``georeference.txt`` with the CRS of their world.

COLMAP's format: https://colmap.github.io/format.html. Quaternion (real part first) and translation are cam_from_world,
so the centre is ``-R^T t``; (0.5, 0.5) is the centre of the top left pixel. The world is the model's map CRS unless
``georeference.txt`` beside the files states another.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.imported.attitude import CameraAxes, RotationDirection, rotation_from_quaternion
from facadelake.georeferencing.imported.records import (
    ImportedLens,
    ImportedPose,
    ImportedPoses,
    UnusablePose,
    read_header,
)
from facadelake.georeferencing.imported.world import SITE, North, PoseWorld

GEOREFERENCE = "georeference.txt"
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_KEYS = ("crs", "site_origin", "offset", "transform")
# The parameters of each camera model as COLMAP orders them.
_CAMERA_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}


def read_colmap_text(folder: Path) -> ImportedPoses:
    """The poses of the COLMAP model in ``folder``; bad lines and unknown camera models are unusable, with the reason.

    Raises InputDataError where a file is missing or not COLMAP's.
    """
    lenses = _read_lenses(folder / "cameras.txt")
    poses, unusable = [], []
    for number, line in _read_image_lines(folder / "images.txt"):
        fields = line.split(maxsplit=9)
        name = fields[9] if len(fields) == 10 else ""
        try:
            if not name:
                raise InputDataError(
                    f"'{line[:60]}' is neither IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME nor a list of points"
                )
            lens = lenses.get(fields[8], f"camera {fields[8]} is not in cameras.txt")
            if isinstance(lens, str):
                raise InputDataError(lens)
            numbers = _parse_numbers(fields[1:8])
            world_from_cam = rotation_from_quaternion(
                numbers[:4], RotationDirection.CAM_FROM_WORLD, CameraAxes.RIGHT_DOWN_FORWARD
            )
            poses.append(
                ImportedPose(
                    image=name, xyz_world=-world_from_cam @ numbers[4:7], world_from_cam=world_from_cam, lens=lens
                )
            )
        except InputDataError as error:
            unusable.append(UnusablePose(image=name, reason=f"images.txt, line {number}: {error}"))
    return ImportedPoses(
        source=f"{folder.name}/images.txt",
        world=_read_world(folder / GEOREFERENCE),
        poses=tuple(poses),
        unusable=tuple(unusable),
    )


def _read_lines(path: Path) -> list[tuple[int, str]]:
    """The file's lines with their numbers, comments left out, empty ones kept."""
    lines = enumerate(_read_text(path).splitlines(), start=1)
    return [(number, line.strip()) for number, line in lines if not line.startswith("#")]


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputDataError(f"COLMAP's {path} cannot be read as text: {error}") from error


def _read_image_lines(path: Path) -> list[tuple[int, str]]:
    """The lines that are not lists of points, whether or not every image has its (perhaps empty) line of points."""
    return [(number, line) for number, line in _read_lines(path) if line and not _is_point_list(line)]


def _is_point_list(line: str) -> bool:
    """Whether a line repeats X, Y, POINT3D_ID."""
    fields = line.split()
    return len(fields) % 3 == 0 and all(_NUMBER.fullmatch(field) for field in fields)


def _parse_numbers(fields: list[str]) -> Float64Array:
    try:
        numbers = np.array([float(field) for field in fields])
    except ValueError as error:
        raise InputDataError(f"'{' '.join(fields)}' are not all numbers") from error
    if not np.isfinite(numbers).all():
        raise InputDataError(f"'{' '.join(fields)}' are not all finite")
    return numbers


def _read_lenses(path: Path) -> dict[str, ImportedLens | str]:
    """The lenses by camera id, or the reason why one cannot be used."""
    lenses: dict[str, ImportedLens | str] = {}
    for number, line in _read_lines(path):
        fields = line.split()
        if not fields:
            continue
        if len(fields) < 5:
            raise InputDataError(f"{path}, line {number}: '{line}' is not CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        names = _CAMERA_MODELS.get(fields[1])
        if names is None:
            lenses[fields[0]] = (
                f"camera {fields[0]} has the model {fields[1]}; supported are {', '.join(_CAMERA_MODELS)}: calibrate "
                "with one of these (OPENCV fits most lenses)"
            )
            continue
        try:
            width, height, *values = _parse_numbers(fields[2:])
            given = dict(zip(names, values, strict=True))
        except (InputDataError, ValueError) as error:
            lenses[fields[0]] = (
                f"cameras.txt, line {number}: {fields[1]} has the parameters {', '.join(names)} ({error})"
            )
            continue
        focal = given.get("f", 0.0)
        lenses[fields[0]] = ImportedLens(
            fx_px=given.get("fx", focal),
            fy_px=given.get("fy", focal),
            cx_px=given["cx"],
            cy_px=given["cy"],
            **{name: given.get(name, 0.0) for name in ("k1", "k2", "p1", "p2")},
            width_px=int(width),
            height_px=int(height),
        )
    if not lenses:
        raise InputDataError(f"{path} lists no cameras")
    return lenses


def _read_world(path: Path) -> PoseWorld:
    """The world frame by ``georeference.txt``: a CRS, and an offset or a similarity into it."""
    if not path.is_file():
        return PoseWorld(crs=None, north=North.GRID)
    lines = "\n".join(f"# {line.lstrip('# ')}" for line in _read_text(path).splitlines())
    header, rest = read_header(path, lines, _KEYS)
    if rest.strip() or "crs" not in header or ("offset" in header and "transform" in header):
        raise InputDataError(
            f"{path}: give crs (an EPSG code or 'site') and at most one of offset (x y z) and transform (scale qw qx "
            f"qy qz tx ty tz, as COLMAP writes a sim3), each on its line as 'key: value'; found {header}"
        )
    crs = header["crs"]
    origin = None
    if "site_origin" in header:
        lon, lat, height = _parse_vector(path, header, "site_origin", 3)
        origin = SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=height)
    crs_from_world = None
    if "offset" in header:
        crs_from_world = Similarity(rotation=np.eye(3), translation=_parse_vector(path, header, "offset", 3))
    elif "transform" in header:
        scale, w, x, y, z, *shift = _parse_vector(path, header, "transform", 8)
        if not (scale > 0 and np.linalg.norm([w, x, y, z]) > 0):
            raise InputDataError(
                f"{path}, transform: {header['transform']}: the scale and the quaternion's length must be positive"
            )
        crs_from_world = Similarity(
            rotation=Rotation.from_quat([x, y, z, w]).as_matrix(), translation=np.array(shift), scale=float(scale)
        )
    return PoseWorld(
        crs=crs, north=North.TRUE if crs == SITE else North.GRID, origin=origin, crs_from_world=crs_from_world
    )


def _parse_vector(path: Path, header: dict[str, str], key: str, count: int) -> Float64Array:
    """The ``count`` numbers of ``key``, separated by blanks, commas or semicolons."""
    fields = re.split(r"[\s,;]+", header[key].strip())
    try:
        numbers = _parse_numbers(fields)
    except InputDataError as error:
        raise InputDataError(f"{path}, {key}: {error}") from error
    if len(numbers) != count:
        raise InputDataError(f"{path}, {key}: {len(numbers)} numbers, {count} are needed")
    return numbers
