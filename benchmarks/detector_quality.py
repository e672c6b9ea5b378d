"""Detectors beside one another on the same real photographs of sites that the default model never learned from.

    .venv/bin/python -m benchmarks.detector_quality default other.onnx ...      # one Markdown table
    .venv/bin/python -m benchmarks.detector_quality default --write-card        # and the figures into the first's card

Every model needs its card; the classical crack filter is always beside them. Cracks: the test split of
`training/data/sites.yaml` (only the models trained by us are known not to have seen it) and, never learned from by us,
boxes about the masks of `masonry_crack_240`. Spalling: a COCO folder, if one is given (`training.data.judged`).
Moisture: mould indoors. False alarms at each card's threshold: the castle's facade, by area from its model and
published cameras; held-out facades, by area; a street, by photograph. Whole photographs: AUROC.
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
from benchmarks.detector_sets import (
    castle_facade,
    crack_images,
    facades,
    masonry,
    mould,
    spalling,
    street,
    with_sources,
)
from benchmarks.foundation import SHARED
from facadelake.detection import Crosswalk, build_crosswalk
from facadelake.evaluation.detectors import (
    ImageLevelFigures,
    locate_model_file,
    write_plots,
    write_results,
    write_sheets,
)
from facadelake.evaluation.detectors.false_alarms import FalseAlarmRate
from facadelake.evaluation.detectors.figures import BoxEvaluation, ClassFigures, evaluate_boxes
from facadelake.evaluation.detectors.image_level import evaluate_image_labels, open_image_labels
from facadelake.evaluation.detectors.labels.labels import LabelledSet
from facadelake.evaluation.detectors.predictions import PredictionSource, collect_predictions
from facadelake.evaluation.detectors.sources import OnnxPredictionSource
from schemas.vocabulary import DefectClass

WHOLE = (
    SHARED / "defects" / "spalling_patches_130",
    SHARED / "defects" / "wall_crops" / "crops",
    SHARED / "defects" / "mould_indoor",
)
_NOTHING = LabelledSet(name="", label_format="", images=())


@dataclass(frozen=True, kw_only=True)
class Exam:
    """Photographs with boxes, or (``sound``) without defects, and how the tables call them."""

    name: str
    labelled: LabelledSet
    split: str | None = None
    sound: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """One detector's answers, an exam each, and on photographs labelled as a whole; ``sees`` are its classes."""

    name: str
    sees: frozenset[DefectClass]
    judgements: tuple[BoxEvaluation, ...]
    whole: tuple[ImageLevelFigures, ...]


def exams(work: Path, spalling_folder: Path | None) -> list[Exam]:
    """All of them; ``work`` must last as long as they are used."""
    found = [
        Exam(name="cracks, test sites", labelled=crack_images("test"), split="test"),
        Exam(name="cracks, masonry", labelled=masonry()),
        Exam(name="moisture, mould indoors", labelled=mould(work)),
        Exam(name="castle", labelled=castle_facade(work), sound=True),
        Exam(name="facades", labelled=facades(), split="test", sound=True),
        Exam(name="street", labelled=street(), split="test", sound=True),
    ]
    if spalling_folder is not None:
        named = replace(spalling(spalling_folder), name="spalling_web")
        found.insert(2, Exam(name="spalling", labelled=named, split=spalling_folder.name))
    return found


def measured(
    looker: PredictionSource, class_names: Sequence[str], crosswalk: Crosswalk, asked: Sequence[Exam], every: int,
    plots: Path | None,
) -> Row:  # fmt: skip
    """All figures of one detector, which names its classes so."""
    judgements = []
    for exam in asked:
        found = collect_predictions(looker, exam.labelled.images, crosswalk)
        if exam.sound:
            nothing = collect_predictions(looker, (), crosswalk)
            judgement = evaluate_boxes(
                looker, _NOTHING, nothing, split=exam.split, negatives=exam.labelled, collected_negatives=found
            )
        else:
            judgement = evaluate_boxes(looker, exam.labelled, found, split=exam.split)
        judgements.append(judgement)
        if plots is not None:
            folder = plots / looker.name.replace(" ", "-") / exam.name.replace(", ", "-").replace(" ", "-")
            write_plots(judgement, folder)
            write_sheets(judgement, found, found if exam.sound else None, folder)
    whole = []
    for path in WHOLE:
        opened = open_image_labels(path, crosswalk)
        opened = replace(opened, labelled=_thinned(with_sources(opened.labelled, path), every))
        whole.append(
            evaluate_image_labels(looker, opened, collect_predictions(looker, opened.labelled.images, crosswalk))
        )
    known = {crosswalk.find_defect_class(name) for name in class_names}
    sees = frozenset(one for one in DefectClass if one in known)
    return Row(name=looker.name, sees=sees, judgements=tuple(judgements), whole=tuple(whole))


def tables(rows: Sequence[Row], asked: Sequence[Exam]) -> str:
    """Boxes, false alarms and whole photographs in Markdown."""
    boxes: list[tuple[str, ...]] = [
        (
            "on", "detector", "AP50", "95 % by sites", "mean of sites", "AP50:95", "precision", "recall", "ECE",
            "photographs/s",
        )
    ]  # fmt: skip
    alarms: list[tuple[str, ...]] = [
        ("on", "detector", "false alarms", "photographs", "m² at mm a pixel", "per 10 m²", "95 %")
    ]
    for i, exam in enumerate(asked):
        for row in rows:
            figures = row.judgements[i].figures
            if figures.negatives is not None:
                gsd = figures.negatives.gsd_mm
                alarms.append((exam.name, row.name, *_alarm_cells(figures.negatives.rates[0], gsd)))
            for one in figures.classes:
                if one.defect_class not in row.sees:
                    continue
                speed = f"{figures.photographs_per_s:.1f}"
                boxes.append((exam.name, row.name, *_box_cells(one), speed))
    whole: list[tuple[str, ...]] = [
        ("photographs of", "class", "detector", "AUROC", "95 %", "average precision", "with it / sound")
    ]
    for k in range(len(WHOLE)):
        for row in rows:
            for part in row.whole[k].classes:
                if part.defect_class not in row.sees:
                    continue
                interval = part.auroc_by_sites
                whole.append(
                    (
                        row.whole[k].name, str(part.defect_class), row.name, _text(part.auroc),
                        "-" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}",
                        _text(part.average_precision), f"{part.with_defect} / {part.sound}",
                    )
                )  # fmt: skip
    return "\n\n".join(_markdown(part) for part in (boxes, alarms, whole))


def _box_cells(one: ClassFigures) -> tuple[str, ...]:
    interval = one.ap50_by_sites
    return (
        _text(one.ap50),
        "-" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}",
        _text(one.mean_ap50_of_sites),
        _text(one.ap50_95),
        _text(one.operating.precision),
        _text(one.operating.recall),
        _text(one.calibration.ece),
    )


def _alarm_cells(rate: FalseAlarmRate, gsd_mm: float | None) -> tuple[str, ...]:
    area = "unknown" if rate.area_m2 is None or gsd_mm is None else f"{rate.area_m2:.0f} at {gsd_mm:.1f}"
    interval = "-" if rate.low_per_10_m2 is None else f"{rate.low_per_10_m2:.3f} to {rate.high_per_10_m2:.3f}"
    return str(rate.count), str(rate.photographs), area, _text(rate.per_10_m2), interval


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    head, *rest = lines
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *rest))


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _thinned(labelled: LabelledSet, every: int) -> LabelledSet:
    return replace(labelled, images=labelled.images[::every])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=["default"], help="'default' or ONNX files with their cards")
    parser.add_argument("--spalling", type=Path, help="COCO folder with boxes of spalling, named by its split")
    parser.add_argument("--write-card", action="store_true", help="write the first model's figures into its card")
    parser.add_argument("--plots", type=Path, help="folder for pictures, a folder each")
    parser.add_argument("--output", type=Path, help="write the tables there, too")
    parser.add_argument("--every", type=int, default=1, help="only every n-th photograph of all sets, for a trial")
    options = parser.parse_args()
    if options.write_card and options.every > 1:
        parser.error("--write-card wants all photographs, not --every n-th")
    # Where a file lay on this machine is nobody's business: its name and its folder's are.
    told = ["/".join(Path(word).parts[-2:]) if Path(word).is_absolute() else word for word in sys.argv[1:]]
    command = shlex.join(["python", "-m", "benchmarks.detector_quality", *told])
    with tempfile.TemporaryDirectory() as folder:
        asked = exams(Path(folder), options.spalling)
        asked = [replace(exam, labelled=_thinned(exam.labelled, options.every)) for exam in asked]
        rows = []
        for i, name in enumerate(options.models):
            path = locate_model_file(name)
            looker = OnnxPredictionSource(path)
            rows.append(
                measured(
                    looker,
                    looker.card.class_names,
                    build_crosswalk(looker.card.classes),
                    asked,
                    options.every,
                    options.plots,
                )
            )
            print(f"measured {path}", file=sys.stderr, flush=True)
            if i == 0 and options.write_card:
                for judgement in rows[0].judgements:
                    write_results(path, judgement.figures, [], command=command)
                print(f"written: {write_results(path, None, rows[0].whole, command=command)}", file=sys.stderr)
        rows.append(measured(ClassicalCracks(), ["crack"], build_crosswalk({}), asked, options.every, options.plots))
    text = f"# Detectors on real photographs of other sites\n\n`{command}`\n\n{tables(rows, asked)}\n"
    print(text)
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
