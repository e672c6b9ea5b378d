"""Read ``poses.csv``: a line a photograph, conventions stated in its head (docs/poses-csv.md)."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import GEO, SiteOrigin
from facadelake.georeferencing.imported.attitude import (
    CameraAxes,
    PitchZero,
    RotationDirection,
    rotation_from_matrix,
    rotation_from_omega_phi_kappa,
    rotation_from_quaternion,
    rotation_from_yaw_pitch_roll,
)
from facadelake.georeferencing.imported.records import (
    ImportedLens,
    ImportedPose,
    ImportedPoses,
    UnusablePose,
    read_header,
)
from facadelake.georeferencing.imported.world import SITE, North, PoseWorld

_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")
_SITE_COLUMNS = ("x_site_m", "y_site_m", "z_site_m")
_CRS_COLUMNS = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
_MATRIX = tuple(f"r{row}{column}" for row in range(3) for column in range(3))
_YAW = ("yaw_deg", "pitch_deg", "roll_deg")
_OMEGA = ("omega_deg", "phi_deg", "kappa_deg")
_LENS = ("fx_px", "fy_px", "cx_px", "cy_px")
_DISTORTION = ("k1", "k2", "p1", "p2")
_SIZE = ("image_width_px", "image_height_px")
_SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m", "sigma_attitude_deg")
_KEYS = (
    "crs", "site_origin", "rotation", "camera_axes", "pitch_zero", "north", "top_left_pixel", "sigma_position_m",
    "sigma_attitude_deg",
)  # fmt: skip
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")

Keyword = TypeVar("Keyword", bound=StrEnum)


@dataclass(frozen=True, kw_only=True)
class _CsvConventions:
    """How the lines of one file are to be read."""

    image: str
    position: tuple[str, ...]
    attitude: tuple[str, ...]
    direction: RotationDirection
    axes: CameraAxes
    zero: PitchZero
    pixel_shift: float
    has: frozenset[str]
    sigmas: tuple[float, float] | None


def read_poses_csv(path: Path) -> ImportedPoses:
    """Every line of the file as a pose, or as unusable with the reason.

    Raises InputDataError where the file as a whole cannot be read: its head, its columns, its CRS.
    """
    text = _read_text(path)
    head, body = read_header(path, text, _KEYS)
    delimiter = max(",;\t", key=body.partition("\n")[0].count)
    reader = csv.DictReader(body.splitlines(), delimiter=delimiter)
    columns = [name.strip() for name in reader.fieldnames or ()]
    reader.fieldnames = columns
    layout, world, remarks = _parse_conventions(path, columns, head)
    poses, unusable = [], []
    for row in reader:
        image = (row.get(layout.image) or "").strip()
        try:
            poses.append(_parse_pose(image, {name: value or "" for name, value in row.items() if name}, layout))
        except InputDataError as error:
            unusable.append(UnusablePose(image=image, reason=f"{path.name}: {error}"))
    return ImportedPoses(
        source=path.name, world=world, poses=tuple(poses), unusable=tuple(unusable), remarks=tuple(remarks)
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputDataError(f"poses {path} cannot be read as text in UTF-8: {error}") from error


def _parse_conventions(
    path: Path, columns: list[str], head: Mapping[str, str]
) -> tuple[_CsvConventions, PoseWorld, list[str]]:
    """How to read the lines, the world they are in, and what the head leaves to be assumed."""
    image = next((name for name in ("image", "photo_id") if name in columns), None)
    missing = [name for name in _LENS if name not in columns]
    if image is None or missing:
        raise InputDataError(
            f"poses {path} have no column {', '.join([*([] if image else ['image']), *missing])} (they have "
            f"{', '.join(columns) or 'none'}); docs/poses-csv.md says which are needed"
        )
    # Geographic columns go first: they need no origin.
    position = _choose_columns(path, columns, (_GEO, _SITE_COLUMNS, _CRS_COLUMNS), "position", several=True)
    attitude = _choose_columns(path, columns, (_QUATERNION, _MATRIX, _YAW, _OMEGA), "attitude", several=False)
    remarks = []
    direction = _parse_keyword(path, head, "rotation", RotationDirection.WORLD_FROM_CAM)
    if attitude in (_QUATERNION, _MATRIX) and "rotation" not in head:
        remarks.append(f"{path.name} does not say which way its rotations turn: taken as {direction}")
    grid = North.GRID if position == _CRS_COLUMNS else North.TRUE
    north = _parse_keyword(path, head, "north", grid)
    if attitude == _YAW and "north" not in head:
        north = North.TRUE  # of a compass and a gimbal
    crs = GEO if position == _GEO else SITE if position == _SITE_COLUMNS else head.get("crs")
    if position != _CRS_COLUMNS and head.get("crs", crs) != crs:
        raise InputDataError(
            f"poses {path} say crs: {head['crs']}, but their columns {', '.join(position)} are of {crs}; name the "
            "columns x, y, z, or correct the head"
        )
    corner = _parse_number(path, head.get("top_left_pixel", "0.5"), "top_left_pixel")
    if corner not in (0.0, 0.5):
        raise InputDataError(f"poses {path} say top_left_pixel: {corner:g}; its centre is 0.5 (COLMAP) or 0 (OpenCV)")
    stated = tuple(
        _parse_number(path, head[key], key) for key in ("sigma_position_m", "sigma_attitude_deg") if key in head
    )
    if len(stated) == 1 or any(value <= 0 for value in stated):
        raise InputDataError(f"poses {path}: give sigma_position_m and sigma_attitude_deg both, and positive")
    layout = _CsvConventions(
        image=image,
        position=position,
        attitude=attitude,
        direction=direction,
        axes=_parse_keyword(path, head, "camera_axes", CameraAxes.RIGHT_DOWN_FORWARD),
        zero=_parse_keyword(path, head, "pitch_zero", PitchZero.HORIZON),
        pixel_shift=0.5 - corner,
        has=frozenset(columns),
        sigmas=(stated[0], stated[1]) if stated else None,
    )
    return layout, PoseWorld(crs=crs, north=north, origin=_parse_origin(path, head)), remarks


def _choose_columns(
    path: Path, columns: list[str], sets: tuple[tuple[str, ...], ...], what: str, *, several: bool
) -> tuple[str, ...]:
    whole = [names for names in sets if set(names) <= set(columns)]
    if not whole or (len(whole) > 1 and not several):
        offered = " or ".join(", ".join(names) for names in sets)
        raise InputDataError(
            f"poses {path} give the {what} {'in several ways' if whole else 'in no known way'} (columns: "
            f"{', '.join(columns)}); give {offered}"
        )
    return whole[0]


def _parse_keyword(path: Path, head: Mapping[str, str], key: str, default: Keyword) -> Keyword:
    kind = type(default)
    try:
        return kind(head.get(key, default))
    except ValueError as error:
        raise InputDataError(
            f"poses {path} say {key}: {head[key]}; allowed are {', '.join(word for word in kind)}"
        ) from error


def _parse_number(path: Path, text: str, key: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputDataError(f"poses {path} say {key}: '{text}', which is no number") from error


def _parse_origin(path: Path, head: Mapping[str, str]) -> SiteOrigin | None:
    if "site_origin" not in head:
        return None
    numbers = _NUMBER.findall(head["site_origin"])
    if len(numbers) != 3:
        raise InputDataError(
            f"poses {path} say site_origin: {head['site_origin']}; give lon, lat and height (EPSG:4979)"
        )
    lon, lat, height = map(float, numbers)
    return SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=height)


def _parse_values(row: Mapping[str, str], names: tuple[str, ...]) -> Float64Array:
    values = []
    for name in names:
        try:
            values.append(float(row[name]))
        except (KeyError, ValueError) as error:
            raise InputDataError(f"column {name}: '{row.get(name, '')}' is no number") from error
    numbers = np.array(values)
    if not np.isfinite(numbers).all():
        raise InputDataError(f"columns {', '.join(names)}: a value is not finite")
    return numbers


def _parse_pose(image: str, row: Mapping[str, str], layout: _CsvConventions) -> ImportedPose:
    if not image:
        raise InputDataError("a line without the name of its photograph")
    fx, fy, *centre = _parse_values(row, _LENS)
    cx, cy = np.array(centre) + layout.pixel_shift
    distortion = [
        float(_parse_values(row, (name,))[0]) if name in layout.has and row[name] else 0.0 for name in _DISTORTION
    ]
    size = [round(value) for value in _parse_values(row, _SIZE)] if set(_SIZE) <= layout.has else [None, None]
    k1, k2, p1, p2 = distortion
    return ImportedPose(
        image=image,
        xyz_world=_parse_values(row, layout.position),
        world_from_cam=_parse_attitude(_parse_values(row, layout.attitude), layout),
        lens=ImportedLens(
            fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, k1=k1, k2=k2, p1=p1, p2=p2, width_px=size[0], height_px=size[1]
        ),
        covariance=_parse_covariance(row, layout),
    )  # fmt: skip


def _parse_attitude(values: Float64Array, layout: _CsvConventions) -> Float64Array:
    if layout.attitude == _QUATERNION:
        return rotation_from_quaternion(values, layout.direction, layout.axes)
    if layout.attitude == _MATRIX:
        return rotation_from_matrix(values.reshape(3, 3), layout.direction, layout.axes)
    first, second, third = values.tolist()
    if layout.attitude == _YAW:
        return rotation_from_yaw_pitch_roll(first, second, third, layout.zero)
    return rotation_from_omega_phi_kappa(first, second, third)


def _parse_covariance(row: Mapping[str, str], layout: _CsvConventions) -> Float64Array | None:
    """The line's own 36 numbers, its sigmas, or the head's; None where nothing is said."""
    if "covariance" in layout.has and row["covariance"].strip():
        numbers = np.array([float(number) for number in _NUMBER.findall(row["covariance"])])
        if numbers.size != 36:
            raise InputDataError(f"column covariance: {numbers.size} numbers, 36 are needed (6 x 6, row by row)")
        whole = numbers.reshape(6, 6)
        if not np.isfinite(whole).all():
            raise InputDataError("column covariance: a value is not finite")
        if np.linalg.eigvalsh((whole + whole.T) / 2)[0] <= 0 or not np.allclose(whole, whole.T, rtol=1e-6, atol=1e-18):
            raise InputDataError("column covariance: not symmetric with positive variances")
        symmetric: Float64Array = (whole + whole.T) / 2
        return symmetric
    if set(_SIGMAS) <= layout.has and row[_SIGMAS[0]].strip():
        sigmas = _parse_values(row, _SIGMAS)
        if (sigmas <= 0).any():
            raise InputDataError(f"columns {', '.join(_SIGMAS)}: a sigma must be positive")
        return np.diag(np.array([*sigmas[:3], *[np.radians(sigmas[3])] * 3]) ** 2)
    if layout.sigmas is not None:
        return np.diag([layout.sigmas[0] ** 2] * 3 + [np.radians(layout.sigmas[1]) ** 2] * 3)
    return None
