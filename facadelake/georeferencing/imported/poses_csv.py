"""``poses.csv``: one line a photograph, with the conventions stated in a header (docs/poses-csv.md)."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

import numpy as np

from facadelake.core.arrays import Float64Array, Float64x3x3
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.proj.crs import GEO
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
    """The conventions of one file.

    ``image``, ``position`` and ``attitude``: the columns to read; ``columns``: all columns; ``pixel_shift``: to add to
    the principal point; ``sigmas``: one sigma of all positions (m) and attitudes (deg), or None.
    """

    image: str
    position: tuple[str, ...]
    attitude: tuple[str, ...]
    direction: RotationDirection
    camera_axes: CameraAxes
    pitch_zero: PitchZero
    pixel_shift: float
    columns: frozenset[str]
    sigmas: tuple[float, float] | None


def read_poses_csv(path: Path) -> ImportedPoses:
    """Every line of the file as a pose, or as unusable with the reason.

    Raises InputDataError where the file as a whole cannot be read: its header, its columns, its CRS.
    """
    header, body = read_header(path, _read_text(path), _KEYS)
    delimiter = max(",;\t", key=body.partition("\n")[0].count)
    reader = csv.DictReader(body.splitlines(), delimiter=delimiter)
    columns = [name.strip() for name in reader.fieldnames or ()]
    reader.fieldnames = columns
    conventions, world, remarks = _parse_conventions(path, columns, header)
    poses, unusable = [], []
    for row in reader:
        image = (row.get(conventions.image) or "").strip()
        try:
            poses.append(_parse_pose(image, {name: value or "" for name, value in row.items() if name}, conventions))
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
    path: Path, columns: list[str], header: Mapping[str, str]
) -> tuple[_CsvConventions, PoseWorld, list[str]]:
    """The conventions of the lines, their world, and remarks on conventions that the header does not state."""
    image = next((name for name in ("image", "photo_id") if name in columns), None)
    missing = [name for name in _LENS if name not in columns]
    if image is None or missing:
        raise InputDataError(
            f"poses {path} have no column {', '.join([*([] if image else ['image']), *missing])} (columns: "
            f"{', '.join(columns) or 'none'}); docs/poses-csv.md lists those needed"
        )
    # Geographic columns go first: they need no origin.
    position = _choose_columns(path, columns, (_GEO, _SITE_COLUMNS, _CRS_COLUMNS), "position", several=True)
    attitude = _choose_columns(path, columns, (_QUATERNION, _MATRIX, _YAW, _OMEGA), "attitude", several=False)
    remarks = []
    direction = _parse_keyword(path, header, "rotation", RotationDirection.WORLD_FROM_CAM)
    if attitude in (_QUATERNION, _MATRIX) and "rotation" not in header:
        remarks.append(f"{path.name} does not state the direction of its rotations: taken as {direction}")
    grid = North.GRID if position == _CRS_COLUMNS else North.TRUE
    north = _parse_keyword(path, header, "north", grid)
    if attitude == _YAW and "north" not in header:
        north = North.TRUE  # of a compass and a gimbal
    crs = GEO if position == _GEO else SITE if position == _SITE_COLUMNS else header.get("crs")
    if position != _CRS_COLUMNS and header.get("crs", crs) != crs:
        raise InputDataError(
            f"poses {path} state crs: {header['crs']}, but their columns {', '.join(position)} are in {crs}; name the "
            "columns x, y, z, or correct the header"
        )
    corner = _parse_number(path, header.get("top_left_pixel", "0.5"), "top_left_pixel")
    if corner not in (0.0, 0.5):
        raise InputDataError(f"poses {path} state top_left_pixel: {corner:g}; its centre is 0.5 (COLMAP) or 0 (OpenCV)")
    stated = tuple(
        _parse_number(path, header[key], key) for key in ("sigma_position_m", "sigma_attitude_deg") if key in header
    )
    if len(stated) == 1 or any(value <= 0 for value in stated):
        raise InputDataError(f"poses {path}: give both sigma_position_m and sigma_attitude_deg, and positive")
    conventions = _CsvConventions(
        image=image,
        position=position,
        attitude=attitude,
        direction=direction,
        camera_axes=_parse_keyword(path, header, "camera_axes", CameraAxes.RIGHT_DOWN_FORWARD),
        pitch_zero=_parse_keyword(path, header, "pitch_zero", PitchZero.HORIZON),
        pixel_shift=0.5 - corner,
        columns=frozenset(columns),
        sigmas=(stated[0], stated[1]) if stated else None,
    )
    return conventions, PoseWorld(crs=crs, north=north, origin=_parse_origin(path, header)), remarks


def _choose_columns(
    path: Path, columns: list[str], alternatives: tuple[tuple[str, ...], ...], quantity: str, *, several: bool
) -> tuple[str, ...]:
    """The first alternative whose columns are all there; ``several`` may be there only where that is allowed."""
    complete = [names for names in alternatives if set(names) <= set(columns)]
    if not complete or (len(complete) > 1 and not several):
        allowed = " or ".join(", ".join(names) for names in alternatives)
        raise InputDataError(
            f"poses {path} give the {quantity} {'in several ways' if complete else 'in no known way'} (columns: "
            f"{', '.join(columns)}); give {allowed}"
        )
    return complete[0]


def _parse_keyword(path: Path, header: Mapping[str, str], key: str, default: Keyword) -> Keyword:
    kind = type(default)
    try:
        return kind(header.get(key, default))
    except ValueError as error:
        raise InputDataError(
            f"poses {path} state {key}: {header[key]}; allowed are {', '.join(keyword for keyword in kind)}"
        ) from error


def _parse_number(path: Path, text: str, key: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputDataError(f"poses {path} state {key}: '{text}', which is not a number") from error


def _parse_origin(path: Path, header: Mapping[str, str]) -> SiteOrigin | None:
    if "site_origin" not in header:
        return None
    numbers = _NUMBER.findall(header["site_origin"])
    if len(numbers) != 3:
        raise InputDataError(
            f"poses {path} state site_origin: {header['site_origin']}; give lon, lat and height (EPSG:4979)"
        )
    lon, lat, height = map(float, numbers)
    return SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=height)


def _parse_values(row: Mapping[str, str], names: tuple[str, ...]) -> Float64Array:
    values = []
    for name in names:
        try:
            values.append(float(row[name]))
        except (KeyError, ValueError) as error:
            raise InputDataError(f"column {name}: '{row.get(name, '')}' is not a number") from error
    numbers = np.array(values)
    if not np.isfinite(numbers).all():
        raise InputDataError(f"columns {', '.join(names)}: a value is not finite")
    return numbers


def _parse_pose(image: str, row: Mapping[str, str], conventions: _CsvConventions) -> ImportedPose:
    if not image:
        raise InputDataError("a line has no name of a photograph")
    columns = conventions.columns
    fx, fy, *centre = _parse_values(row, _LENS)
    cx, cy = np.array(centre) + conventions.pixel_shift
    distortion = [
        float(_parse_values(row, (name,))[0]) if name in columns and row[name] else 0.0 for name in _DISTORTION
    ]
    size = [round(value) for value in _parse_values(row, _SIZE)] if set(_SIZE) <= columns else [None, None]
    k1, k2, p1, p2 = distortion
    return ImportedPose(
        image=image,
        xyz_world=_parse_values(row, conventions.position),
        world_from_cam=_parse_attitude(_parse_values(row, conventions.attitude), conventions),
        lens=ImportedLens(
            fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, k1=k1, k2=k2, p1=p1, p2=p2, width_px=size[0], height_px=size[1]
        ),
        covariance=_parse_covariance(row, conventions),
    )  # fmt: skip


def _parse_attitude(values: Float64Array, conventions: _CsvConventions) -> Float64x3x3:
    if conventions.attitude == _QUATERNION:
        return rotation_from_quaternion(values, conventions.direction, conventions.camera_axes)
    if conventions.attitude == _MATRIX:
        return rotation_from_matrix(values.reshape(3, 3), conventions.direction, conventions.camera_axes)
    first, second, third = values.tolist()
    if conventions.attitude == _YAW:
        return rotation_from_yaw_pitch_roll(first, second, third, conventions.pitch_zero)
    return rotation_from_omega_phi_kappa(first, second, third)


def _parse_covariance(row: Mapping[str, str], conventions: _CsvConventions) -> Float64Array | None:
    """Covariance (6, 6) by the line's own 36 numbers, its sigmas, or the header's; None where none is stated."""
    if "covariance" in conventions.columns and row["covariance"].strip():
        numbers = np.array([float(number) for number in _NUMBER.findall(row["covariance"])])
        if numbers.size != 36:
            raise InputDataError(f"column covariance: {numbers.size} numbers, 36 are needed (6 x 6, row by row)")
        matrix = numbers.reshape(6, 6)
        if not np.isfinite(matrix).all():
            raise InputDataError("column covariance: a value is not finite")
        if np.linalg.eigvalsh((matrix + matrix.T) / 2)[0] <= 0 or not np.allclose(
            matrix, matrix.T, rtol=1e-6, atol=1e-18
        ):
            raise InputDataError("column covariance: not symmetric with positive variances")
        symmetric: Float64Array = (matrix + matrix.T) / 2
        return symmetric
    if set(_SIGMAS) <= conventions.columns and row[_SIGMAS[0]].strip():
        sigmas = _parse_values(row, _SIGMAS)
        if (sigmas <= 0).any():
            raise InputDataError(f"columns {', '.join(_SIGMAS)}: a sigma must be positive")
        return np.diag(np.array([*sigmas[:3], *[np.radians(sigmas[3])] * 3]) ** 2)
    if conventions.sigmas is not None:
        return np.diag([conventions.sigmas[0] ** 2] * 3 + [np.radians(conventions.sigmas[1]) ** 2] * 3)
    return None
