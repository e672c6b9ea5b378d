"""Read poses of any of the known formats."""

from __future__ import annotations

from pathlib import Path

from facadelake.georeferencing.imported.colmap import read_colmap_text
from facadelake.georeferencing.imported.poses_csv import read_poses_csv
from facadelake.georeferencing.imported.records import ImportedPoses, list_pose_files


def read_poses(path: Path) -> ImportedPoses:
    """The poses at ``path``: a poses.csv, or COLMAP's text files in a folder.

    Raises InputDataError where there are none or the file as a whole cannot be read; a line that gives no pose is
    unusable, with its reason.
    """
    first, *_ = list_pose_files(path)
    return read_poses_csv(first) if first.suffix.lower() == ".csv" else read_colmap_text(first.parent)
