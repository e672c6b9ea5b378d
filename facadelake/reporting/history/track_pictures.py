"""Pictures of one track through all campaigns of its building: each campaign beside the one before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.registry import Building
from facadelake.reporting.cards.crops import format_file_label
from facadelake.reporting.history.comparison import TABLES, compare_campaigns, order_campaigns
from facadelake.reporting.history.draw import (
    BuildingTables,
    create_request,
    create_track_marks,
    read_origin,
    read_photographs,
    read_surface,
)
from facadelake.reporting.history.explanation import read_track_tables
from facadelake.reporting.history.pairs import Pair, write_pairs


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackPictures:
    """Files written of a track, and remarks on the pairs of campaigns without pictures."""

    paths: tuple[Path, ...]
    remarks: tuple[str, ...]


def draw_track(
    track_id: str, building: Building | None, lake: Path, folder: Path, *, as_of: int | None
) -> TrackPictures:
    """Write before, after and difference of a track for each campaign and the one before it.

    Args:
        track_id: the track.
        building: its building in the portfolio; None: it is not registered.
        lake: folder of the lake.
        folder: folder to write into.
        as_of: an earlier version of the lake; None: the newest.

    Returns:
        The files, in folders ``<earlier>_to_<later>``.

    Raises:
        InputDataError: the lake has no such track.
    """
    tables = read_track_tables(lake, track_id, (*TABLES, "buildings", "poses"), as_of=as_of)
    building_id = str(tables["tracks"].column("building_id")[0])
    history = BuildingTables(building_id=building_id, lake=lake, version=as_of, tables=tables)
    committed = {row["campaign_id"]: row for row in tables["buildings"].to_pylist()}
    names = [row["campaign_id"] for row in order_campaigns(tables["campaigns"])]
    origin = read_origin(committed[names[-1]])
    _, surface, told = read_surface(building, names[-1], committed[names[-1]])
    paths: list[Path] = []
    remarks: list[str] = [told] if told else []
    for earlier, later in pairwise(names):
        try:
            comparison = compare_campaigns(tables, earlier, later)
        except InputDataError as error:
            remarks.append(f"{earlier} to {later}: {error}")
            continue
        for track in comparison.tracks:
            mark = create_track_marks([track.place], [track_id], origin)[track_id]
            pairs = write_pairs(
                [create_request(track, comparison, mark)],
                read_photographs(history, building, earlier, origin),
                read_photographs(history, building, later, origin),
                surface,
                folder / f"{format_file_label(earlier)}_to_{format_file_label(later)}",
            )
            paths += _list_files(pairs)
            remarks += [f"{earlier} to {later}: {text}" for pair in pairs.values() for text in pair.remarks]
    return TrackPictures(paths=tuple(paths), remarks=tuple(remarks))


def _list_files(pairs: Mapping[str, Pair]) -> list[Path]:
    return [path for pair in pairs.values() for path in (pair.before, pair.after, pair.difference) if path is not None]
