"""The truth of a building's history: what each defect was on the day of each campaign, and which boxes show it.

Two layouts of files are read into one record type: that of the demo (a folder a campaign) and that of a pair of
campaigns (one table). ``read_history_truth`` tells them apart by their files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.evaluation.truth_tables import CsvRow, read_truth_rows
from schemas.vocabulary import DefectClass, TrackState

_FALSE_IN_DEMO, _FALSE_IN_PAIR = "off_target", "false"
_PAIR_GROWTH = 1.4  # factor of width and height of a defect of state "grown", as the pair's provenance states
_PHOTOGRAPHS = "photographs_"
_DEMO_COLUMNS = ("id", "class", "true_state", "width_m", "height_m", "photographs_of_place")
_PAIR_EXISTS = {
    "seen": (True, True),
    "grown": (True, True),
    "repaired": (True, False),
    "new": (False, True),
}
_LAYOUTS = (
    "truth of a history is either a folder with campaigns/CAMPAIGN/truth/defects.csv and detections.csv (as that of "
    "the demo), or one with defects.csv and detections.csv of a pair of campaigns (columns state, "
    "photographs_CAMPAIGN; campaign)"
)


@dataclass(frozen=True, kw_only=True)
class TrueDefect:
    """A true defect, or its place, on the day of a campaign.

    ``imaged``: whether a photograph shows the place well enough. ``width_m``, ``height_m``: its size, 0 where it does
    not exist. ``stated``: the state that the file of truth gives; None where it gives none.
    """

    true_id: str
    campaign_id: str
    defect_class: DefectClass
    exists: bool
    imaged: bool
    width_m: float
    height_m: float
    stated: TrackState | None = None


@dataclass(frozen=True, kw_only=True)
class HistoryTruth:
    """True defects by campaign, each campaign with all of them in one order, and the defect that each box shows.

    ``true_id_of_annotation``: by campaign, then by (file, annotation id); None for a false detection. ``path`` of
    the files with these, by campaign, for messages.
    """

    defects: Mapping[str, Sequence[TrueDefect]]
    true_id_of_annotation: Mapping[str, Mapping[tuple[str, str], str | None]]
    path: Mapping[str, Path]


def read_history_truth(folder: Path) -> HistoryTruth:
    """Read the truth of a history. Raises InputDataError where it is of no known layout, or invalid."""
    if (folder / "campaigns").is_dir():
        return _read_campaign_folders(folder / "campaigns")
    for candidate in (folder, folder / "truth"):
        if (candidate / "defects.csv").is_file() and (candidate / "detections.csv").is_file():
            return _read_pair(candidate)
    raise InputDataError(f"{folder} has no truth of a history: {_LAYOUTS}")


def _read_campaign_folders(folder: Path) -> HistoryTruth:
    """The demo's layout; a campaign without truth is left out."""
    paths = {path.parent.parent.name: path for path in sorted(folder.glob("*/truth/defects.csv"))}
    if not paths:
        raise InputDataError(f"{folder} has no truth of a history: {_LAYOUTS}")
    defects: dict[str, list[TrueDefect]] = {}
    for campaign, path in paths.items():
        rows = read_truth_rows(path, "id", *_DEMO_COLUMNS)
        defects[campaign] = [_parse_demo_defect(row, campaign) for row in rows]
    _require_same_ids(defects, paths)
    annotations = {}
    for campaign, path in paths.items():
        file = path.with_name("detections.csv")
        rows = read_truth_rows(file, None, "file", "annotation_id", "checkpoint_id")
        known = {defect.true_id for defect in defects[campaign]}
        annotations[campaign] = _collect_annotations(rows, "checkpoint_id", _FALSE_IN_DEMO, known)
    return HistoryTruth(
        defects=defects,
        true_id_of_annotation=annotations,
        path={campaign: path.with_name("detections.csv") for campaign, path in paths.items()},
    )


def _parse_demo_defect(row: CsvRow, campaign: str) -> TrueDefect:
    exists = row["true_state"] not in ("absent", "repaired")
    stated = row.get("track_state")
    if stated and stated not in set(TrackState):
        raise InputDataError(f"{row.place}, column track_state: '{stated}' is not one of {', '.join(TrackState)}")
    return TrueDefect(
        true_id=row["id"],
        campaign_id=campaign,
        defect_class=_parse_class(row),
        exists=exists,
        imaged=_parse_number(row, "photographs_of_place") > 0,
        width_m=_parse_number(row, "width_m") if exists else 0.0,
        height_m=_parse_number(row, "height_m") if exists else 0.0,
        stated=TrackState(stated) if stated else None,
    )


def _read_pair(folder: Path) -> HistoryTruth:
    """The layout of a pair. Of places without a defect it does not say whether they were imaged: they are taken to be,
    as its states (new, repaired) can be told only then."""
    path, file = folder / "defects.csv", folder / "detections.csv"
    rows = read_truth_rows(path, "id", "id", "class", "state", "width_m", "height_m")
    campaigns = sorted(
        {name.removeprefix(_PHOTOGRAPHS) for row in rows for name in row if name.startswith(_PHOTOGRAPHS)}
    )
    if len(campaigns) != 2:
        raise InputDataError(
            f"{path} has columns {_PHOTOGRAPHS}CAMPAIGN for {len(campaigns)} campaigns ({', '.join(campaigns)}); "
            f"its states are those of a pair. {_LAYOUTS}"
        )
    defects: dict[str, list[TrueDefect]] = {campaign: [] for campaign in campaigns}
    for row in rows:
        if row["state"] not in _PAIR_EXISTS:
            raise InputDataError(f"{row.place}, column state: '{row['state']}' is not one of {', '.join(_PAIR_EXISTS)}")
        for number, (campaign, exists) in enumerate(zip(campaigns, _PAIR_EXISTS[row["state"]], strict=True)):
            growth = _PAIR_GROWTH if row["state"] == "grown" and number else 1.0
            count = _parse_number(row, _PHOTOGRAPHS + campaign)
            defects[campaign].append(
                TrueDefect(
                    true_id=row["id"],
                    campaign_id=campaign,
                    defect_class=_parse_class(row),
                    exists=exists,
                    imaged=count > 0 if exists else True,
                    width_m=growth * _parse_number(row, "width_m") if exists else 0.0,
                    height_m=growth * _parse_number(row, "height_m") if exists else 0.0,
                )
            )
    listed = read_truth_rows(file, None, "campaign", "file", "annotation_id", "defect_id")
    known = {defect.true_id for defect in defects[campaigns[0]]}
    return HistoryTruth(
        defects=defects,
        true_id_of_annotation={
            campaign: _collect_annotations(
                (row for row in listed if row["campaign"] == campaign), "defect_id", _FALSE_IN_PAIR, known
            )
            for campaign in campaigns
        },
        path=dict.fromkeys(campaigns, file),
    )


def _collect_annotations(
    rows: Iterable[CsvRow], column: str, false: str, known: set[str]
) -> dict[tuple[str, str], str | None]:
    """The true defect of each (file, annotation id); what is none of the ``known`` (off the building) is None."""
    found: dict[tuple[str, str], str | None] = {}
    for row in rows:
        key, true_id = (row["file"], row["annotation_id"]), row[column]
        if key in found:
            raise InputDataError(f"{row.place}: annotation {key[1]} of {key[0]} is listed twice; keep one line")
        if true_id != false and true_id not in known:
            raise InputDataError(
                f"{row.place}, column {column}: '{true_id}' is neither an id of defects.csv nor '{false}'"
            )
        found[key] = None if true_id == false else true_id
    return found


def _require_same_ids(defects: Mapping[str, Sequence[TrueDefect]], paths: Mapping[str, Path]) -> None:
    """Every campaign lists all defects, those that do not exist yet too. Raises InputDataError."""
    first, *others = defects
    expected = [defect.true_id for defect in defects[first]]
    for campaign in others:
        ids = [defect.true_id for defect in defects[campaign]]
        if ids != expected:
            different = sorted(set(ids) ^ set(expected))
            raise InputDataError(
                f"{paths[campaign]} and {paths[first]} do not list the same defects in one order (in one alone: "
                f"{', '.join(different) or 'none'}); list every defect in every campaign, with its state"
            )


def _parse_class(row: CsvRow) -> DefectClass:
    if row["class"] not in set(DefectClass):
        raise InputDataError(f"{row.place}, column class: '{row['class']}' is not one of {', '.join(DefectClass)}")
    return DefectClass(row["class"])


def _parse_number(row: CsvRow, column: str) -> float:
    try:
        value = float(row[column])
    except (KeyError, ValueError):
        value = -1.0
    if not 0 <= value < 1e6:
        raise InputDataError(f"{row.place}, column {column}: '{row.get(column, '')}' is not a number from 0 up")
    return value
