"""Imported poses as a file states them, and the header lines ``# key: value`` that state its conventions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from facadelake.core.arrays import Float64Array, Float64x3, Float64x3x3
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError
from facadelake.georeferencing.imported.world import PoseWorld

_KEY_VALUE = re.compile(r"#?\s*([A-Za-z_]+)\s*:\s*(.*)")


def read_header(path: Path, text: str, keys: Sequence[str]) -> tuple[dict[str, str], str]:
    """The values of the lines before the table, by key, and the rest of the text.

    A line ``# key: value`` must have one of ``keys``, so that a misspelt key is not ignored; other lines that begin
    with # are comments. Raises InputDataError for an unknown key or one that is stated twice.
    """
    values: dict[str, str] = {}
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), len(lines))
    for number, line in enumerate(lines[:begin], start=1):
        match = _KEY_VALUE.fullmatch(line.strip())
        if match is None:
            continue
        key, value = match[1], match[2].strip()
        if key not in keys:
            close = get_close_matches(key, keys, n=1)
            raise InputDataError(
                f"{path}, line {number}: unknown key '{key}'"
                + (f" (did you mean '{close[0]}'?)" if close else "")
                + f"; allowed are {', '.join(keys)} (a comment must not begin with a word and a colon)"
            )
        if key in values:
            raise InputDataError(f"{path}, line {number}: {key} is stated twice; keep one line")
        values[key] = value
    return values, "\n".join(lines[begin:])


@dataclass(frozen=True, kw_only=True)
class ImportedLens:
    """Intrinsics for a photograph of ``width_px`` x ``height_px``; None: for the photograph as it is stored."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    width_px: int | None = None
    height_px: int | None = None

    def scale_to(self, width_px: int, height_px: int) -> Camera:
        """The camera of a photograph of that size, scaled where the photograph is a reduced one.

        Raises InputDataError where the aspect ratios differ, or a focal length is not positive.
        """
        lens_width, lens_height = self.width_px or width_px, self.height_px or height_px
        x, y = width_px / lens_width, height_px / lens_height
        if abs(lens_width * y - width_px) > 1.0 and abs(lens_height * x - height_px) > 1.0:
            raise InputDataError(
                f"its camera has {lens_width} x {lens_height} px, the photograph {width_px} x {height_px} px: the "
                "aspect ratios differ; give the poses of these photographs as they are stored"
            )
        # The corner of the top left pixel is (0, 0), so a scaled photograph has scaled coordinates.
        return Camera(
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * x,
            fy_px=self.fy_px * y,
            cx_px=self.cx_px * x,
            cy_px=self.cy_px * y,
            k1=self.k1,
            k2=self.k2,
            p1=self.p1,
            p2=self.p2,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedPose:
    """A line of the file: position (3,) in its world, ``world_from_cam`` (3, 3; camera x right, y down, z forward).

    ``covariance`` (6, 6): centre in m along east, north and up, attitude in rad about the camera's axes; None where
    the file states none.
    """

    image: str
    xyz_world: Float64x3
    world_from_cam: Float64x3x3
    lens: ImportedLens
    covariance: Float64Array | None = None


@dataclass(frozen=True, kw_only=True)
class UnusablePose:
    """A line without a valid pose, and the reason."""

    image: str
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedPoses:
    """A file of poses; ``remarks`` name assumptions on conventions that it does not state."""

    source: str
    world: PoseWorld
    poses: tuple[ImportedPose, ...]
    unusable: tuple[UnusablePose, ...] = ()
    remarks: tuple[str, ...] = ()
