"""Add persons' words to table ``reviews``: a version of the lake of its own; nothing in the table is ever changed.

The words belong to no run: an inspection that replaces a campaign's rows leaves them as they are.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.core.duckdb_engine import wrap_store_errors
from facadelake.core.errors import InputDataError, SchemaError
from facadelake.lake.connect import LOCK_TIMEOUT_S, has_lake
from facadelake.lake.migrate import open_to_write
from facadelake.lake.read import read_tables
from facadelake.lake.transaction import get_last_version, insert, make_version
from schemas.tables import LAKE_TABLES

logger = logging.getLogger(__name__)

_OF_THE_LAKE = ("review_id", "reviewed_at", "run_id")  # what may differ between two words that say the same
_REMEDY = "no review was written; check free space and rights of the lake's folder, then run again"


@dataclass(frozen=True, kw_only=True)
class AppendResult:
    """How many words were written, how many said what their reviewer had said last of the same subject, and the
    lake's version that holds them (None: nothing was written)."""

    added: int
    unchanged: int
    version: int | None


def append_reviews(
    lake: Path, words: pa.Table, *, building_id: str, campaign_id: str, lock_timeout_s: float = LOCK_TIMEOUT_S
) -> AppendResult:
    """Append ``words``, rows of table ``reviews`` of one campaign with empty ids, in one transaction.

    Saying the same again adds nothing. Raises InputDataError where the lake does not hold the campaign, SchemaError
    for rows that are not as schemas/ declares, StoreError when the lake cannot be written (it then stays as it was).
    """
    _check(words, building_id, campaign_id)
    if not has_lake(lake):
        raise InputDataError(f"there is no lake in {lake}, so there is nothing to review; inspect a campaign first")
    with open_to_write(lake, lock_timeout_s) as connection:
        held = read_tables(lake, ["campaigns", "reviews"], building_id=building_id, campaign_id=campaign_id)
        if not len(held["campaigns"]):
            raise InputDataError(
                f"the lake {lake} does not hold {building_id} {campaign_id}, so there is nothing to review; "
                "'facadelake campaigns' lists what it holds"
            )
        new = _new_words(words, held["reviews"])
        if not len(new):
            return AppendResult(added=0, unchanged=len(words), version=None)
        first = len(held["reviews"]) + 1
        ids = [f"{building_id}-{campaign_id}-R{number:05d}" for number in range(first, first + len(new))]
        at = new.schema.get_field_index("review_id")
        new = new.set_column(at, new.schema.field(at), pa.array(ids, pa.string()))
        with wrap_store_errors(f"writing reviews of {building_id} {campaign_id} to the lake {lake}", _REMEDY):
            version = _write(connection, new, building_id, campaign_id)
    logger.info("%d reviews of %s %s added as version %d", len(new), building_id, campaign_id, version)
    return AppendResult(added=len(new), unchanged=len(words) - len(new), version=version)


def _check(words: pa.Table, building_id: str, campaign_id: str) -> None:
    wanted = LAKE_TABLES["reviews"].arrow
    if not words.schema.equals(wanted):
        raise SchemaError(f"table reviews has the columns {words.schema.to_string()}; the lake's are {wanted}")
    for key, value in (("building_id", building_id), ("campaign_id", campaign_id)):
        found = set(words.column(key).unique().to_pylist()) - {value}
        if found:
            raise SchemaError(f"table reviews has rows with {key} {sorted(map(str, found))}; these are of {value}")


def _new_words(words: pa.Table, held: pa.Table) -> pa.Table:
    """The words that say something else than the last one held on their subject; of several the last."""
    plain = [name for name in words.column_names if name not in _OF_THE_LAKE]
    last = {
        row["subject"]: [row[name] for name in plain]
        for row in held.sort_by([("reviewed_at", "ascending"), ("review_id", "ascending")]).to_pylist()
    }
    keep = []
    for place, row in enumerate(words.to_pylist()):
        if last.get(row["subject"]) != [row[name] for name in plain]:
            keep.append(place)
            last[row["subject"]] = [row[name] for name in plain]
    return words.take(pa.array(keep, pa.int64()))


def _write(connection: duckdb.DuckDBPyConnection, words: pa.Table, building_id: str, campaign_id: str) -> int:
    reviewers = ", ".join(sorted(set(words.column("reviewer").to_pylist())))
    origin = {"building_id": building_id, "campaign_id": campaign_id, "reviewed_by": reviewers}
    with make_version(connection, f"{building_id} {campaign_id} reviewed by {reviewers}", origin):
        insert(connection, LAKE_TABLES["reviews"], words)
    return get_last_version(connection)
