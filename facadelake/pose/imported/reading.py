"""Read poses of any of the known formats."""

from __future__ import annotations

from pathlib import Path

from facadelake.pose.imported.colmap import read_colmap_text
from facadelake.pose.imported.records import ImportedPoses, pose_files
from facadelake.pose.imported.table import read_poses_csv


def read_poses(path: Path) -> ImportedPoses:
    """The poses at ``path``: a poses.csv, or COLMAP's text files in a folder.

    Raises InputDataError where there are none or the file as a whole cannot be read; a line that gives no pose is
    unusable, with its reason.
    """
    first, *_ = pose_files(path)
    return read_poses_csv(first) if first.suffix.lower() == ".csv" else read_colmap_text(first.parent)
