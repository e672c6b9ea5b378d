"""A committed campaign's files for GIS and for people: immutable, one folder a version of the lake.

``<lake>/published/<building>/<campaign>/v000012/`` is made beside its place and renamed, its files are read-only;
``latest`` beside it leads to the highest version.
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
from facadelake.publish.geopackage import create_facade_layers, create_map_layers, write_layers
from facadelake.publish.geoparquet import drop_heights, geodataframe_from_table, write_geoparquet
from facadelake.publish.readme import format_readme

PUBLISHED = "published"
LATEST = "latest"
REPORT = "report.html"
FILES = ("defects.parquet", "defects_2d.parquet", "observations.parquet", "defects.gpkg", "README.txt")
TABLES = ("buildings", "georeference", "runs", "campaigns", "defects", "observations")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_VERSION = re.compile(r"v([0-9]{6,})")
_OLDER_GRADES_ID = 'id="drawn-for-another-version"'

logger = logging.getLogger(__name__)


def name_release_folder(lake: Path, *, building_id: str, campaign_id: str, version: int) -> Path:
    """Where the files of a campaign in a version of the lake are, or would be.

    Raises InputDataError for an id that is no plain name, because it becomes a folder.
    """
    for name in (building_id, campaign_id):
        if not _NAME.fullmatch(name):
            raise InputDataError(f"the id '{name}' cannot name a folder; use letters, digits, '.', '_' and '-'")
    return lake / PUBLISHED / building_id / campaign_id / f"v{version:06d}"


def publish_campaign(
    lake: Path, *, building_id: str, campaign_id: str, version: int, pictures: Path | None = None
) -> Path:
    """Publish the campaign as it is in ``version`` of the lake, with the files of the folder ``pictures``, if given.

    A version that is there already stays as it is. Raises StoreError where the lake or the disk fails (nothing
    half-made is left), InputDataError where the lake has no such campaign.
    """
    folder = name_release_folder(lake, building_id=building_id, campaign_id=campaign_id, version=version)
    if folder.is_dir():
        logger.info("%s is published already", folder)
        return folder
    tables = read_tables(lake, TABLES, building_id=building_id, campaign_id=campaign_id, as_of=version)
    if not len(tables["campaigns"]):
        raise InputDataError(f"the lake {lake} has no campaign {campaign_id} of {building_id} in its version {version}")
    part = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.part"
    try:
        part.mkdir(parents=True)
        _write_files(part, tables, version=version, pictures=pictures)
        for path in part.rglob("*"):
            if path.is_file():
                path.chmod(0o444)
        part.rename(folder)
        _point_latest(folder.parent)
    except OSError as error:
        if folder.is_dir():  # another process was quicker with the same version
            return folder
        raise StoreError(
            f"publishing {building_id} {campaign_id} to {folder} failed: {error}; the commit is safe in version "
            f"{version} of the lake: free some space, check rights, and run again"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def publish_regraded(lake: Path, *, building_id: str, campaign_id: str, version: int) -> Path:
    """Publish the campaign as ``version`` graded it, with the pictures of the release before, which show older grades.

    The report says so. Raises as ``publish_campaign``.
    """
    publish = partial(publish_campaign, lake, building_id=building_id, campaign_id=campaign_id, version=version)
    folder = name_release_folder(lake, building_id=building_id, campaign_id=campaign_id, version=version)
    before = [number for number in _find_releases(folder.parent) if number < version] if folder.parent.is_dir() else []
    if folder.is_dir() or not before:
        return publish()
    drawn = _find_releases(folder.parent)[max(before)]
    try:
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as scratch:
            pictures = Path(scratch) / "pictures"
            shutil.copytree(drawn, pictures, ignore=shutil.ignore_patterns(*FILES))
            _mark_report(pictures / REPORT, max(before))
            return publish(pictures=pictures)
    except OSError as error:
        raise StoreError(
            f"publishing {building_id} {campaign_id} to {folder} failed: {error}; the grades are safe in version "
            f"{version} of the lake: free some space, check rights, and run again"
        ) from error


def _mark_report(report: Path, version: int) -> None:
    """Say in a report that its grades are those of ``version``, unless it says of which already."""
    if not report.is_file():
        return
    text = report.read_text("utf-8")
    if _OLDER_GRADES_ID in text:
        return
    note = (
        f"<p {_OLDER_GRADES_ID}><b>Drawn for version {version} of the lake; the defects were graded anew since. "
        "The tables beside this page have the grades that hold.</b></p>"
    )
    report.chmod(0o644)  # the release it comes from is read-only
    report.write_text(text.replace("</h1>", f"</h1>{note}", 1), encoding="utf-8")


def _write_files(folder: Path, tables: dict[str, pa.Table], *, version: int, pictures: Path | None) -> None:
    if pictures is not None:
        shutil.copytree(pictures, folder, dirs_exist_ok=True)
    defects = tables["defects"]
    points = geodataframe_from_table(defects)
    in_3d, in_2d, observations, layers, text = (folder / name for name in FILES)
    write_geoparquet(points, in_3d)
    write_geoparquet(drop_heights(points), in_2d)
    write_geoparquet(geodataframe_from_table(tables["observations"]), observations)
    write_layers(chain(create_map_layers(defects, "defects"), create_facade_layers(defects)), layers)
    text.write_text(format_readme(tables, version=version), encoding="utf-8")


def _find_releases(campaign: Path) -> dict[int, Path]:
    return {int(found[1]): path for path in campaign.iterdir() if (found := _VERSION.fullmatch(path.name))}


def _point_latest(campaign: Path) -> None:
    """Let ``latest`` lead to the highest version, at no moment to nothing; a copy where links cannot be made."""
    versions = _find_releases(campaign)
    newest = versions[max(versions)]
    latest, part = campaign / LATEST, campaign / f".{LATEST}.{uuid.uuid4().hex[:8]}"
    try:
        part.symlink_to(newest.name, target_is_directory=True)
    except OSError as error:
        logger.info("no symbolic links in %s (%s): latest is a copy", campaign, error)
        shutil.copytree(newest, part)
    if latest.is_dir() and not latest.is_symlink():  # a copy from before: a folder cannot be replaced in one step
        latest.rename(part.with_suffix(".old"))
    part.replace(latest)
    shutil.rmtree(part.with_suffix(".old"), ignore_errors=True)
