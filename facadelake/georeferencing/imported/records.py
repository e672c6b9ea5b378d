"""Poses that another program found, as a file says them, and the lines ``# key: value`` that state its conventions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError
from facadelake.georeferencing.imported.world import PoseWorld

_KEY_VALUE = re.compile(r"#?\s*([A-Za-z_]+)\s*:\s*(.*)")


def read_header(path: Path, text: str, keys: Sequence[str]) -> tuple[dict[str, str], str]:
    """What the lines before the table say, by key, and the rest of the text.

    A line ``# word: value`` must have one of ``keys``, so that a misspelt one is not passed over; other lines that
    begin with # are comments. Raises InputDataError for an unknown key or one that is said twice.
    """
    said: dict[str, str] = {}
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), len(lines))
    for number, line in enumerate(lines[:begin], start=1):
        found = _KEY_VALUE.fullmatch(line.strip())
        if found is None:
            continue
        key, value = found[1], found[2].strip()
        if key not in keys:
            close = get_close_matches(key, keys, n=1)
            raise InputDataError(
                f"{path}, line {number}: unknown key '{key}'"
                + (f" (did you mean '{close[0]}'?)" if close else "")
                + f"; allowed are {', '.join(keys)} (a comment must not begin with a word and a colon)"
            )
        if key in said:
            raise InputDataError(f"{path}, line {number}: {key} is said twice; keep one line")
        said[key] = value
    return said, "\n".join(lines[begin:])


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
        """The camera of a photograph of that size; a reduced one of the same shape is scaled.

        Raises InputDataError where the shapes differ, or a focal length is not positive.
        """
        own_width, own_height = self.width_px or width_px, self.height_px or height_px
        x, y = width_px / own_width, height_px / own_height
        if abs(own_width * y - width_px) > 1.0 and abs(own_height * x - height_px) > 1.0:
            raise InputDataError(
                f"its camera is of {own_width} x {own_height} px, the photograph of {width_px} x {height_px} px, which "
                "is another shape; give the poses of these photographs as they are stored"
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
    xyz_world: Float64Array
    world_from_cam: Float64Array
    lens: ImportedLens
    covariance: Float64Array | None = None


@dataclass(frozen=True, kw_only=True)
class UnusablePose:
    """A line that gives no pose, and why."""

    image: str
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedPoses:
    """A file of poses; ``remarks`` say in words what had to be assumed."""

    source: str
    world: PoseWorld
    poses: tuple[ImportedPose, ...]
    unusable: tuple[UnusablePose, ...] = ()
    remarks: tuple[str, ...] = ()


def list_pose_files(path: Path) -> tuple[Path, ...]:
    """The files that poses at ``path`` consist of: a CSV file, or COLMAP's texts in a folder (any of them names it).

    Raises InputDataError where there are none.
    """
    if path.is_file() and path.suffix.lower() == ".csv":
        return (path,)
    folder = path if path.is_dir() else path.parent
    if path.is_dir() and (folder / "poses.csv").is_file():
        return (folder / "poses.csv",)
    texts = [folder / name for name in ("images.txt", "cameras.txt", "georeference.txt")]
    if path.is_dir() or (path in texts and path.is_file()):
        if texts[0].is_file() and texts[1].is_file():
            return tuple(text for text in texts if text.is_file())
        if (folder / "images.bin").is_file():
            raise InputDataError(
                f"{folder} holds a COLMAP model in binary form; write it as text: colmap model_converter --input_path "
                f"{folder} --output_path {folder} --output_type TXT"
            )
    raise InputDataError(
        f"there are no poses at {path}; give a poses.csv (docs/poses-csv.md says what is in it), or a folder with "
        "COLMAP's images.txt and cameras.txt"
    )
