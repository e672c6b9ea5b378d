"""A committed campaign's files for GIS and for people: immutable, one folder a version of the lake.

``<lake>/published/<building>/<campaign>/v000012/`` is made beside its place and renamed, its files are read-only;
``latest`` beside it leads to the highest version.
"""

from __future__ import annotations

import logging
import re
import shutil
import uuid
from itertools import chain
from pathlib import Path

import pyarrow as pa

from facadelake.errors import InputDataError, StoreError
from facadelake.lake.read import read_tables
from facadelake.publish.export import export
from facadelake.publish.geopackage import facade_layers, geo_layers, write_layers
from facadelake.publish.geoparquet import flat, frame, write_geoparquet
from facadelake.publish.readme import readme

__all__ = ["export", "publish_campaign", "release_folder"]

PUBLISHED = "published"
LATEST = "latest"
TABLES = ("buildings", "georeference", "runs", "campaigns", "defects", "observations")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_VERSION = re.compile(r"v([0-9]{6,})")

logger = logging.getLogger(__name__)


def release_folder(lake: Path, *, building_id: str, campaign_id: str, version: int) -> Path:
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
    folder = release_folder(lake, building_id=building_id, campaign_id=campaign_id, version=version)
    if folder.is_dir():
        logger.info("%s is published already", folder)
        return folder
    tables = read_tables(lake, TABLES, building_id=building_id, campaign_id=campaign_id, as_of=version)
    if not len(tables["campaigns"]):
        raise InputDataError(f"the lake {lake} has no campaign {campaign_id} of {building_id} in its version {version}")
    part = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.part"
    try:
        part.mkdir(parents=True)
        _write(part, tables, version=version, pictures=pictures)
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


def _write(folder: Path, tables: dict[str, pa.Table], *, version: int, pictures: Path | None) -> None:
    if pictures is not None:
        shutil.copytree(pictures, folder, dirs_exist_ok=True)
    defects = tables["defects"]
    points = frame(defects)
    write_geoparquet(points, folder / "defects.parquet")
    write_geoparquet(flat(points), folder / "defects_2d.parquet")
    write_geoparquet(frame(tables["observations"]), folder / "observations.parquet")
    write_layers(chain(geo_layers(defects, "defects"), facade_layers(defects)), folder / "defects.gpkg")
    (folder / "README.txt").write_text(readme(tables, version=version), encoding="utf-8")


def _point_latest(campaign: Path) -> None:
    """Let ``latest`` lead to the highest version, at no moment to nothing; a copy where links cannot be made."""
    versions = {int(found[1]): path for path in campaign.iterdir() if (found := _VERSION.fullmatch(path.name))}
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
