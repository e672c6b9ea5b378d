"""Releases: the files published from a committed campaign, immutable, one folder per version of the lake.

``<lake>/published/<building>/<campaign>/v000012/`` is written under a temporary name and renamed; its files are
read-only. ``latest`` in the same folder points to the highest version.
"""

from __future__ import annotations

import logging
import re
import shutil
import tempfile
import uuid
from functools import partial
from itertools import chain
from pathlib import Path

import pyarrow as pa

from facadelake.core.errors import InputDataError, StoreError
from facadelake.lake import read_tables
from facadelake.publish.geopackage import (
    create_coverage_layers,
    create_facade_layers,
    create_map_layers,
    write_layers,
)
from facadelake.publish.geoparquet import drop_heights, geodataframe_from_table, write_geoparquet
from facadelake.publish.history import TABLES as HISTORY
from facadelake.publish.history import create_history_layers, join_states
from facadelake.publish.older_grades import mark_older_grades
from facadelake.publish.readme import format_readme

PUBLISHED = "published"
LATEST = "latest"
FILES = (
    "defects.parquet",
    "defects_2d.parquet",
    "observations.parquet",
    "coverage.parquet",
    "tracks.parquet",
    "history.parquet",
    "defects.gpkg",
    "README.txt",
)
TABLES = ("buildings", "georeference", "runs", "campaigns", "defects", "observations", "coverage")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_VERSION = re.compile(r"v([0-9]{6,})")

logger = logging.getLogger(__name__)


def name_release_folder(lake: Path, *, building_id: str, campaign_id: str, version: int) -> Path:
    """Folder of the release of a campaign in a version of the lake; it need not exist.

    Args:
        lake: folder of the lake.
        building_id: building; becomes the name of a folder.
        campaign_id: campaign; becomes the name of a folder.
        version: version of the lake.

    Returns:
        ``<lake>/published/<building_id>/<campaign_id>/v<version>``.

    Raises:
        InputDataError: an id contains characters other than letters, digits, '.', '_' and '-'.
    """
    for name in (building_id, campaign_id):
        if not _NAME.fullmatch(name):
            raise InputDataError(f"the id '{name}' cannot name a folder; use letters, digits, '.', '_' and '-'")
    return lake / PUBLISHED / building_id / campaign_id / f"v{version:06d}"


def publish_campaign(
    lake: Path, *, building_id: str, campaign_id: str, version: int, pictures: Path | None = None
) -> Path:
    """Publish a campaign as it is in a version of the lake; a release that exists is left unchanged.

    Args:
        lake: folder of the lake.
        building_id: building.
        campaign_id: campaign.
        version: version of the lake to read.
        pictures: folder whose files are copied into the release, such as the report; None: no pictures.

    Returns:
        The folder of the release.

    Raises:
        InputDataError: the lake has no such campaign in that version.
        StoreError: reading the lake or writing the files failed; no partial release is left.
    """
    folder = name_release_folder(lake, building_id=building_id, campaign_id=campaign_id, version=version)
    if folder.is_dir():
        logger.info("release %s exists already", folder)
        return folder
    tables = read_tables(lake, TABLES, building_id=building_id, campaign_id=campaign_id, as_of=version)
    history = read_tables(lake, HISTORY, building_id=building_id, as_of=version)
    if not len(tables["campaigns"]):
        raise InputDataError(f"lake {lake} has no campaign {campaign_id} of {building_id} in version {version}")
    temporary = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.part"
    try:
        temporary.mkdir(parents=True)
        _write_files(temporary, tables, history, version=version, pictures=pictures)
        for path in temporary.rglob("*"):
            if path.is_file():
                path.chmod(0o444)
        temporary.rename(folder)
        _point_latest(folder.parent)
    except OSError as error:
        if folder.is_dir():  # another process published the same version meanwhile
            return folder
        raise StoreError(
            f"publishing {building_id} {campaign_id} to {folder} failed: {error}; the data are committed in version "
            f"{version} of the lake: check free space and permissions, then run again"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def publish_regraded(lake: Path, *, building_id: str, campaign_id: str, version: int) -> Path:
    """Publish a regraded campaign with the pictures of its previous release; report and cards say that grades differ.

    Args:
        lake: folder of the lake.
        building_id: building.
        campaign_id: campaign.
        version: version of the lake with the new grades.

    Returns:
        The folder of the release.

    Raises:
        InputDataError: the lake has no such campaign in that version.
        StoreError: reading the lake or writing the files failed; no partial release is left.
    """
    publish = partial(publish_campaign, lake, building_id=building_id, campaign_id=campaign_id, version=version)
    folder = name_release_folder(lake, building_id=building_id, campaign_id=campaign_id, version=version)
    releases = _find_releases(folder.parent) if folder.parent.is_dir() else {}
    earlier = [number for number in releases if number < version]
    if folder.is_dir() or not earlier:
        return publish()
    previous = max(earlier)
    try:
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as scratch:
            pictures = Path(scratch) / "pictures"
            shutil.copytree(releases[previous], pictures, ignore=shutil.ignore_patterns(*FILES))
            mark_older_grades(pictures, previous)
            return publish(pictures=pictures)
    except OSError as error:
        raise StoreError(
            f"publishing {building_id} {campaign_id} to {folder} failed: {error}; the grades are committed in version "
            f"{version} of the lake: check free space and permissions, then run again"
        ) from error


def _write_files(
    folder: Path,
    tables: dict[str, pa.Table],
    history: dict[str, pa.Table],
    *,
    version: int,
    pictures: Path | None,
) -> None:
    if pictures is not None:
        shutil.copytree(pictures, folder, dirs_exist_ok=True)
    defects = tables["defects"]
    points = geodataframe_from_table(defects)
    defects_3d, defects_2d, observations, coverage, tracks, states, layers, text = (folder / name for name in FILES)
    write_geoparquet(points, defects_3d)
    write_geoparquet(drop_heights(points), defects_2d)
    write_geoparquet(geodataframe_from_table(tables["observations"]), observations)
    cells = tables["coverage"]
    if len(cells):  # a campaign that was committed before coverage was measured has none
        write_geoparquet(geodataframe_from_table(cells), coverage)
    joined = join_states(history)
    if len(history["tracks"]):  # a building whose campaigns were committed without a history has none
        write_geoparquet(geodataframe_from_table(history["tracks"]), tracks)
        write_geoparquet(geodataframe_from_table(joined), states)
    write_layers(
        chain(
            create_map_layers(defects, "defects"),
            create_facade_layers(defects),
            create_coverage_layers(cells),
            create_history_layers(history["tracks"], joined),
        ),
        layers,
    )
    text.write_text(format_readme(tables, joined, version=version), encoding="utf-8")


def _find_releases(campaign: Path) -> dict[int, Path]:
    """Folders of the releases of a campaign by version."""
    return {int(match[1]): path for path in campaign.iterdir() if (match := _VERSION.fullmatch(path.name))}


def _point_latest(campaign: Path) -> None:
    """Point ``latest`` to the highest version, atomically; a copy where the file system has no symbolic links."""
    versions = _find_releases(campaign)
    newest = versions[max(versions)]
    latest, temporary = campaign / LATEST, campaign / f".{LATEST}.{uuid.uuid4().hex[:8]}"
    try:
        temporary.symlink_to(newest.name, target_is_directory=True)
    except OSError as error:
        logger.info("cannot create a symbolic link in %s (%s); latest is a copy", campaign, error)
        shutil.copytree(newest, temporary)
    if latest.is_dir() and not latest.is_symlink():  # an earlier copy: a folder cannot be replaced in one step
        latest.rename(temporary.with_suffix(".old"))
    temporary.replace(latest)
    shutil.rmtree(temporary.with_suffix(".old"), ignore_errors=True)
