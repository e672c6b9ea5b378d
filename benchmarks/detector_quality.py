"""Comparison of detectors on the same real photographs, of sites that are not in the default model's training data.

    .venv/bin/python -m benchmarks.detector_quality default other.onnx ...      # Markdown tables
    .venv/bin/python -m benchmarks.detector_quality default --write-card        # also writes the first model's card

Every model needs its card; the classical ridge filter is always included. Cracks: the test split of
`training/data/sites.yaml` (known to be unused for our own models only) and bounding boxes of the masks of
`masonry_crack_240`, which is in no training data of ours. Spalling: a COCO folder, if given
(`training.data.evaluation_sets`). Moisture: mould in interiors. False alarms at the threshold of each card: the
castle's facade, per area by its model and published cameras; facades of the test split, per area; a street, per
photograph. Labels of whole photographs: AUROC.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.classical_cracks import RidgeCrackFilter
from benchmarks.detector_sets import (
    assign_source_images,
    open_castle_facade,
    open_crack_images,
    open_facades,
    open_masonry,
    open_mould,
    open_spalling,
    open_street,
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

IMAGE_LABELLED_SETS = (
    SHARED / "defects" / "spalling_patches_130",
    SHARED / "defects" / "wall_crops" / "crops",
    SHARED / "defects" / "mould_indoor",
)
_EMPTY_SET = LabelledSet(name="", label_format="", images=())


@dataclass(frozen=True, kw_only=True)
class EvaluationSet:
    """Photographs with boxes, or without defects (``sound``), and their name in the tables."""

    name: str
    labelled: LabelledSet
    split: str | None = None
    sound: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectorFigures:
    """Figures of one detector with ``classes``: by evaluation set, and by set of photographs labelled as a whole."""

    name: str
    classes: frozenset[DefectClass]
    judgements: tuple[BoxEvaluation, ...]
    image_level: tuple[ImageLevelFigures, ...]


def open_evaluation_sets(work: Path, spalling_folder: Path | None) -> list[EvaluationSet]:
    """Open all evaluation sets. Files of some are written to ``work``, which must exist while the sets are in use."""
    found = [
        EvaluationSet(name="cracks, test sites", labelled=open_crack_images("test"), split="test"),
        EvaluationSet(name="cracks, masonry", labelled=open_masonry()),
        EvaluationSet(name="moisture, mould indoors", labelled=open_mould(work)),
        EvaluationSet(name="castle", labelled=open_castle_facade(work), sound=True),
        EvaluationSet(name="facades", labelled=open_facades(), split="test", sound=True),
        EvaluationSet(name="street", labelled=open_street(), split="test", sound=True),
    ]
    if spalling_folder is not None:
        named = replace(open_spalling(spalling_folder), name="spalling_web")
        found.insert(2, EvaluationSet(name="spalling", labelled=named, split=spalling_folder.name))
    return found


def evaluate_detector(
    source: PredictionSource,
    class_names: Sequence[str],
    crosswalk: Crosswalk,
    sets: Sequence[EvaluationSet],
    every: int,
    plots: Path | None,
) -> DetectorFigures:
    """Evaluate one detector on all sets.

    Args:
        source: the detector.
        class_names: its class names.
        crosswalk: defect classes by its class names.
        sets: photographs with boxes or without defects.
        every: only every n-th photograph of the sets labelled as a whole is used.
        plots: folder for plots and sheets of photographs; None for no plots.
    """
    judgements = []
    for evaluation_set in sets:
        found = collect_predictions(source, evaluation_set.labelled.images, crosswalk)
        if evaluation_set.sound:
            empty = collect_predictions(source, (), crosswalk)
            judgement = evaluate_boxes(
                source,
                _EMPTY_SET,
                empty,
                split=evaluation_set.split,
                negatives=evaluation_set.labelled,
                collected_negatives=found,
            )
        else:
            judgement = evaluate_boxes(source, evaluation_set.labelled, found, split=evaluation_set.split)
        judgements.append(judgement)
        if plots is not None:
            folder = plots / source.name.replace(" ", "-") / evaluation_set.name.replace(", ", "-").replace(" ", "-")
            write_plots(judgement, folder)
            write_sheets(judgement, found, found if evaluation_set.sound else None, folder)
    image_level = []
    for path in IMAGE_LABELLED_SETS:
        opened = open_image_labels(path, crosswalk)
        opened = replace(opened, labelled=_take_every(assign_source_images(opened.labelled, path), every))
        image_level.append(
            evaluate_image_labels(source, opened, collect_predictions(source, opened.labelled.images, crosswalk))
        )
    known = {crosswalk.find_defect_class(name) for name in class_names}
    classes = frozenset(one for one in DefectClass if one in known)
    return DetectorFigures(
        name=source.name, classes=classes, judgements=tuple(judgements), image_level=tuple(image_level)
    )


def format_tables(rows: Sequence[DetectorFigures], sets: Sequence[EvaluationSet]) -> str:
    """Markdown tables of boxes, false alarms and labels of whole photographs."""
    boxes: list[tuple[str, ...]] = [
        (
            "on", "detector", "AP50", "95 % by sites", "mean of sites", "AP50:95", "precision", "recall", "ECE",
            "photographs/s",
        )
    ]  # fmt: skip
    alarms: list[tuple[str, ...]] = [
        ("on", "detector", "false alarms", "photographs", "m² at mm a pixel", "per 10 m²", "95 %")
    ]
    for i, evaluation_set in enumerate(sets):
        for row in rows:
            figures = row.judgements[i].figures
            if figures.negatives is not None:
                gsd = figures.negatives.gsd_mm
                alarms.append((evaluation_set.name, row.name, *_format_alarm_cells(figures.negatives.rates[0], gsd)))
            for one in figures.classes:
                if one.defect_class not in row.classes:
                    continue
                speed = f"{figures.photographs_per_s:.1f}"
                boxes.append((evaluation_set.name, row.name, *_format_box_cells(one), speed))
    image_level: list[tuple[str, ...]] = [
        ("photographs of", "class", "detector", "AUROC", "95 %", "average precision", "with defect / sound")
    ]
    for k in range(len(IMAGE_LABELLED_SETS)):
        for row in rows:
            for part in row.image_level[k].classes:
                if part.defect_class not in row.classes:
                    continue
                interval = part.auroc_by_sites
                image_level.append(
                    (
                        row.image_level[k].name, str(part.defect_class), row.name, _format_number(part.auroc),
                        "-" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}",
                        _format_number(part.average_precision), f"{part.with_defect} / {part.sound}",
                    )
                )  # fmt: skip
    return "\n\n".join(_format_markdown(part) for part in (boxes, alarms, image_level))


def _format_box_cells(one: ClassFigures) -> tuple[str, ...]:
    interval = one.ap50_by_sites
    return (
        _format_number(one.ap50),
        "-" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}",
        _format_number(one.mean_ap50_of_sites),
        _format_number(one.ap50_95),
        _format_number(one.operating.precision),
        _format_number(one.operating.recall),
        _format_number(one.calibration.ece),
    )


def _format_alarm_cells(rate: FalseAlarmRate, gsd_mm: float | None) -> tuple[str, ...]:
    area = "unknown" if rate.area_m2 is None or gsd_mm is None else f"{rate.area_m2:.0f} at {gsd_mm:.1f}"
    interval = "-" if rate.low_per_10_m2 is None else f"{rate.low_per_10_m2:.3f} to {rate.high_per_10_m2:.3f}"
    return str(rate.count), str(rate.photographs), area, _format_number(rate.per_10_m2), interval


def _format_markdown(lines: Sequence[Sequence[str]]) -> str:
    head, *rest = lines
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *rest))


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _take_every(labelled: LabelledSet, every: int) -> LabelledSet:
    return replace(labelled, images=labelled.images[::every])


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=["default"], help="'default' or ONNX files with their cards")
    parser.add_argument("--spalling", type=Path, help="COCO folder with boxes of spalling; its name is the split")
    parser.add_argument("--write-card", action="store_true", help="write the first model's figures into its card")
    parser.add_argument("--plots", type=Path, help="folder for plots, with a subfolder for each detector")
    parser.add_argument("--output", type=Path, help="also write the tables to this file")
    parser.add_argument("--every", type=int, default=1, help="use only every n-th photograph of all sets, for a trial")
    options = parser.parse_args()
    if options.write_card and options.every > 1:
        parser.error("--write-card requires all photographs; omit --every")
    # Of absolute paths, only the file and its folder are recorded: the rest is specific to this machine.
    arguments = ["/".join(Path(word).parts[-2:]) if Path(word).is_absolute() else word for word in sys.argv[1:]]
    command = shlex.join(["python", "-m", "benchmarks.detector_quality", *arguments])
    with tempfile.TemporaryDirectory() as folder:
        sets = open_evaluation_sets(Path(folder), options.spalling)
        sets = [
            replace(evaluation_set, labelled=_take_every(evaluation_set.labelled, options.every))
            for evaluation_set in sets
        ]
        rows = []
        for i, name in enumerate(options.models):
            path = locate_model_file(name)
            source = OnnxPredictionSource(path)
            rows.append(
                evaluate_detector(
                    source,
                    source.card.class_names,
                    build_crosswalk(source.card.classes),
                    sets,
                    options.every,
                    options.plots,
                )
            )
            print(f"measured {path}", file=sys.stderr, flush=True)
            if i == 0 and options.write_card:
                for judgement in rows[0].judgements:
                    write_results(path, judgement.figures, [], command=command)
                print(f"written: {write_results(path, None, rows[0].image_level, command=command)}", file=sys.stderr)
        rows.append(
            evaluate_detector(RidgeCrackFilter(), ["crack"], build_crosswalk({}), sets, options.every, options.plots)
        )
    text = f"# Detectors on real photographs of other sites\n\n`{command}`\n\n{format_tables(rows, sets)}\n"
    print(text)
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
