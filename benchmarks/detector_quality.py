"""Detectors beside one another on the same real photographs of sites that the default model never learned from.

    .venv/bin/python -m benchmarks.detector_quality default other.onnx ...      # one Markdown table
    .venv/bin/python -m benchmarks.detector_quality default --write-card        # and the figures into the first's card

Every model needs its card; the classical crack filter is always beside them. Cracks: the test split of
`training/data/sites.yaml` (only the models trained by us are known not to have seen it) and, never learned from by us,
boxes about the masks of `masonry_crack_240`. False alarms at each card's threshold: the castle's facade, by area from
its model and published cameras, and facades of the test split, by photograph. Whole photographs: AUROC.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.classical_cracks import ClassicalCracks
from benchmarks.detector_sets import castle_facade, crack_images, facades, masonry, with_sources
from benchmarks.foundation import SHARED
from facadelake.detect.crosswalk import Crosswalk, crosswalk_with
from facadelake.evaluate.detector.card_results import write_results
from facadelake.evaluate.detector.contact_sheet import write_sheets
from facadelake.evaluate.detector.false_alarms import Rate
from facadelake.evaluate.detector.figures import Figures, Judgement, judge
from facadelake.evaluate.detector.image_level import ImageLevelFigures, judge_image_labels, open_image_labels
from facadelake.evaluate.detector.labels import LabelledSet
from facadelake.evaluate.detector.lookers import OnnxLooker
from facadelake.evaluate.detector.looking import Collected, Looker, collect
from facadelake.evaluate.detector.plots import write_plots
from flows.detector_evaluation import model_file
from schemas.vocabulary import DefectClass

WHOLE = (
    SHARED / "defects" / "spalling_patches_130",
    SHARED / "defects" / "wall_crops" / "crops",
    SHARED / "defects" / "mould_indoor",
)
_NOTHING = LabelledSet(name="", form="", images=())


@dataclass(frozen=True, kw_only=True)
class Sets:
    """What every detector is shown."""

    cracks: LabelledSet
    masonry: LabelledSet
    castle: LabelledSet
    facades: LabelledSet
    every: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """One detector's figures."""

    name: str
    cracks: Judgement
    masonry: Judgement
    castle: Judgement
    facades: Judgement
    whole: tuple[ImageLevelFigures, ...]


def measured(looker: Looker, crosswalk: Crosswalk, sets: Sets, plots: Path | None) -> Row:
    """All figures of one detector."""
    cracks, found = _boxes(looker, crosswalk, sets.cracks, "test")
    stone, found_stone = _boxes(looker, crosswalk, sets.masonry, None)
    castle, alarms = _alarms(looker, crosswalk, sets.castle, None)
    sound, alarms_sound = _alarms(looker, crosswalk, sets.facades, "test")
    if plots is not None:
        folder = plots / looker.name.replace(" ", "-")
        for name, judgement, seen in (
            ("cracks", cracks, found),
            ("masonry", stone, found_stone),
            ("castle", castle, alarms),
            ("facades", sound, alarms_sound),
        ):
            write_plots(judgement, folder / name)
            write_sheets(judgement, seen, seen if judgement.figures.negatives else None, folder / name)
    whole = []
    for path in WHOLE:
        opened = open_image_labels(path, crosswalk)
        opened = replace(opened, labelled=_thinned(with_sources(opened.labelled, path), sets.every))
        whole.append(judge_image_labels(looker, opened, collect(looker, opened.labelled.images, crosswalk)))
    return Row(name=looker.name, cracks=cracks, masonry=stone, castle=castle, facades=sound, whole=tuple(whole))


def _boxes(
    looker: Looker, crosswalk: Crosswalk, labelled: LabelledSet, split: str | None
) -> tuple[Judgement, Collected]:
    found = collect(looker, labelled.images, crosswalk)
    return judge(looker, labelled, found, split=split), found


def _alarms(looker: Looker, crosswalk: Crosswalk, sound: LabelledSet, split: str | None) -> tuple[Judgement, Collected]:
    found = collect(looker, sound.images, crosswalk)
    nothing = collect(looker, (), crosswalk)
    return judge(looker, _NOTHING, nothing, split=split, negatives=sound, collected_negatives=found), found


def table(rows: Sequence[Row]) -> str:
    """Markdown."""
    head = (
        "detector", "cracks: AP50 (95 % by sites)", "mean of sites", "AP50:95", "precision", "recall", "ECE",
        "masonry: AP50", "castle: false alarms", "per 10 m² (95 %)", "facades: false alarms per photograph",
        "photographs of 640 px/s",
    )  # fmt: skip
    lines = [head, ["---"] * len(head), *(_cells(row) for row in rows)]
    whole = [("detector", "whole photographs of", "class", "AUROC (95 %)", "average precision", "with it / sound")]
    whole.append(("---",) * 6)
    for row in rows:
        for figures in row.whole:
            for one in figures.classes:
                drawn = one.auroc_by_sites
                span = "" if drawn is None else f" ({drawn.low:.2f} to {drawn.high:.2f})"
                whole.append(
                    (
                        row.name, figures.name, one.defect_class, f"{_text(one.auroc)}{span}",
                        _text(one.average_precision), f"{one.with_defect} / {one.sound}",
                    )
                )  # fmt: skip
    return "\n\n".join("\n".join("| " + " | ".join(line) + " |" for line in part) for part in (lines, whole))


def _cells(row: Row) -> tuple[str, ...]:
    (crack,) = row.cracks.figures.classes
    (stone,) = row.masonry.figures.classes
    drawn = crack.ap50_by_sites
    span = "" if drawn is None else f" ({drawn.low:.2f} to {drawn.high:.2f})"
    castle, sound = _every(row.castle.figures), _every(row.facades.figures)
    return (
        row.name,
        f"{_text(crack.ap50)}{span}",
        _text(crack.mean_ap50_of_sites),
        _text(crack.ap50_95),
        _text(crack.operating.precision),
        _text(crack.operating.recall),
        _text(crack.calibration.ece),
        _text(stone.ap50),
        f"{castle.count} on {castle.area_m2:.0f} m² looked at, {_gsd(row.castle.figures)}",
        f"{_text(castle.per_10_m2)} ({_text(castle.low_per_10_m2)} to {_text(castle.high_per_10_m2)})",
        f"{sound.count / sound.photographs:.2f} ({sound.count} in {sound.photographs})",
        f"{row.cracks.figures.photographs_per_s:.1f}",
    )


def _gsd(figures: Figures) -> str:
    assert figures.negatives is not None
    return f"{figures.negatives.gsd_mm:.1f} mm a pixel"


def _every(figures: Figures) -> Rate:
    assert figures.negatives is not None
    return figures.negatives.rates[0]


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=["default"], help="'default' or ONNX files with their cards")
    parser.add_argument("--write-card", action="store_true", help="write the first model's figures into its card")
    parser.add_argument("--plots", type=Path, help="folder for pictures, a folder each")
    parser.add_argument("--output", type=Path, help="write the table there, too")
    parser.add_argument("--every", type=int, default=1, help="only every n-th photograph of all sets, for a trial")
    options = parser.parse_args()
    if options.write_card and options.every > 1:
        parser.error("--write-card wants all photographs, not --every n-th")
    with tempfile.TemporaryDirectory() as folder:
        sets = Sets(
            cracks=_thinned(crack_images("test"), options.every),
            masonry=_thinned(masonry(), options.every),
            castle=_thinned(castle_facade(Path(folder)), options.every),
            facades=_thinned(facades("test"), options.every),
            every=options.every,
        )
    rows = []
    for i, name in enumerate(options.models):
        path = model_file(name)
        looker = OnnxLooker(path)
        row = measured(looker, crosswalk_with(looker.card.classes), sets, options.plots)
        rows.append(row)
        print(f"measured {path}", file=sys.stderr, flush=True)
        if i == 0 and options.write_card:
            command = shlex.join(["python", "-m", "benchmarks.detector_quality", *sys.argv[1:]])
            for judgement in (row.cracks, row.masonry, row.castle, row.facades):
                write_results(path, judgement.figures, [], command=command)
            print(f"written: {write_results(path, None, row.whole, command=command)}", file=sys.stderr, flush=True)
    rows.append(measured(ClassicalCracks(), crosswalk_with({}), sets, options.plots))
    text = f"Class {DefectClass.CRACK} unless said.\n\n{table(rows)}\n"
    print(text)
    if options.output is not None:
        options.output.write_text(text, encoding="utf-8")


def _thinned(labelled: LabelledSet, every: int) -> LabelledSet:
    return replace(labelled, images=labelled.images[::every])


if __name__ == "__main__":
    main()
