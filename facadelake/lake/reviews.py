"""Append reviews to a table of reviews, as a version of the lake of their own; rows are never changed.

Reviews belong to no run: an inspection that replaces a campaign's rows keeps them.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.core.errors import InputDataError, SchemaError
from facadelake.lake.connect import LOCK_TIMEOUT_S, has_lake
from facadelake.lake.damage import wrap_lake_errors
from facadelake.lake.migrate import open_to_write
from facadelake.lake.read import read_tables
from facadelake.lake.transaction import get_last_version, insert, make_version
from schemas.tables import LAKE_TABLES

logger = logging.getLogger(__name__)

_OF_THE_LAKE = ("review_id", "reviewed_at", "run_id")  # may differ between two equal reviews
# Of each table of reviews: the column that names what is reviewed, and the letter before the numbers of its ids.
_SUBJECTS = {"reviews": ("subject", "R"), "track_reviews": ("track_id", "T")}
_REMEDY = "no review was written; check free space and rights of the lake's folder, then run again"


@dataclass(frozen=True, kw_only=True)
class AppendResult:
    """Number of reviews added, number equal to the latest review of their subject, and the lake's version that has them
    (None: nothing was written)."""

    added: int
    unchanged: int
    version: int | None


def append_reviews(
    lake: Path,
    reviews: pa.Table,
    *,
    building_id: str,
    campaign_id: str,
    name: str = "reviews",
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> AppendResult:
    """Append reviews of one campaign in one transaction; a review equal to the latest of its subject is not added.

    Args:
        lake: folder of the lake.
        reviews: rows of table ``name`` with empty ids.
        building_id: the building.
        campaign_id: the campaign.
        name: the table: ``reviews`` (of detections) or ``track_reviews`` (of tracks).
        lock_timeout_s: seconds to wait for another process that writes the lake.

    Raises InputDataError where the lake does not hold the campaign, SchemaError
    for rows that are not as schemas/ declares, StoreError when the lake cannot be written (it then stays as it was).
    """
    _require_rows(name, reviews, building_id, campaign_id)
    subject, letter = _SUBJECTS[name]
    if not has_lake(lake):
        raise InputDataError(f"there is no lake in {lake}, so there is nothing to review; inspect a campaign first")
    with open_to_write(lake, lock_timeout_s) as connection:
        held = read_tables(lake, ["campaigns", name], building_id=building_id, campaign_id=campaign_id)
        if not len(held["campaigns"]):
            raise InputDataError(
                f"the lake {lake} does not hold {building_id} {campaign_id}, so there is nothing to review; "
                "'facadelake campaigns' lists what it holds"
            )
        new = _select_new(reviews, held[name], subject)
        if not len(new):
            return AppendResult(added=0, unchanged=len(reviews), version=None)
        first = len(held[name]) + 1
        ids = [f"{building_id}-{campaign_id}-{letter}{number:05d}" for number in range(first, first + len(new))]
        at = new.schema.get_field_index("review_id")
        new = new.set_column(at, new.schema.field(at), pa.array(ids, pa.string()))
        with wrap_lake_errors(lake, f"writing reviews of {building_id} {campaign_id} to the lake {lake}", _REMEDY):
            version = _write(connection, name, new, building_id, campaign_id)
    logger.info("%d reviews of %s %s added as version %d", len(new), building_id, campaign_id, version)
    return AppendResult(added=len(new), unchanged=len(reviews) - len(new), version=version)


def _require_rows(name: str, reviews: pa.Table, building_id: str, campaign_id: str) -> None:
    wanted = LAKE_TABLES[name].arrow
    if not reviews.schema.equals(wanted):
        raise SchemaError(f"table {name} has the columns {reviews.schema.to_string()}; the lake's are {wanted}")
    for key, value in (("building_id", building_id), ("campaign_id", campaign_id)):
        found = set(reviews.column(key).unique().to_pylist()) - {value}
        if found:
            raise SchemaError(f"table {name} has rows with {key} {sorted(map(str, found))}; these are of {value}")


def _select_new(reviews: pa.Table, held: pa.Table, subject: str) -> pa.Table:
    """The reviews that differ from the latest one of the same value of ``subject``; of several the last."""
    plain = [name for name in reviews.column_names if name not in _OF_THE_LAKE]
    last = {
        row[subject]: [row[name] for name in plain]
        for row in held.sort_by([("reviewed_at", "ascending"), ("review_id", "ascending")]).to_pylist()
    }
    keep = []
    for place, row in enumerate(reviews.to_pylist()):
        if last.get(row[subject]) != [row[name] for name in plain]:
            keep.append(place)
            last[row[subject]] = [row[name] for name in plain]
    return reviews.take(pa.array(keep, pa.int64()))


def _write(
    connection: duckdb.DuckDBPyConnection, name: str, reviews: pa.Table, building_id: str, campaign_id: str
) -> int:
    reviewers = ", ".join(sorted(set(reviews.column("reviewer").to_pylist())))
    origin = {"building_id": building_id, "campaign_id": campaign_id, "reviewed_by": reviewers}
    with make_version(connection, f"{building_id} {campaign_id} reviewed by {reviewers}", origin):
        insert(connection, LAKE_TABLES[name], reviews)
    return get_last_version(connection)
