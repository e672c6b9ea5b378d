"""The files of imported poses: which files there are, and reading them in any of the supported formats."""

from __future__ import annotations

from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.georeferencing.imported.colmap import read_colmap_text
from facadelake.georeferencing.imported.poses_csv import read_poses_csv
from facadelake.georeferencing.imported.records import ImportedPoses


def list_pose_files(path: Path) -> tuple[Path, ...]:
    """The files of the poses at ``path``: a CSV file, or COLMAP's text files in a folder (any of them names it).

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
        f"there are no poses at {path}; give a poses.csv (format: docs/poses-csv.md), or a folder with COLMAP's "
        "images.txt and cameras.txt"
    )


def read_poses(path: Path) -> ImportedPoses:
    """Read the poses at ``path``: a poses.csv, or COLMAP's text files in a folder.

    Raises InputDataError where there are none or the file as a whole cannot be read; a line without a valid pose is
    unusable, with its reason.
    """
    first, *_ = list_pose_files(path)
    return read_poses_csv(first) if first.suffix.lower() == ".csv" else read_colmap_text(first.parent)
