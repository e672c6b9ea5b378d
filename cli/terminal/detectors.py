"""The evaluation of a detector in the terminal and as plots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.evaluation.detectors import (
    BootstrapInterval,
    DetectorEvaluation,
    DetectorFigures,
    ImageLevelFigures,
    OperatingPoint,
    write_plots,
    write_sheets,
)

_MOST_SITES = 40


def show_answer(console: Console, answer: DetectorEvaluation) -> None:
    """Print tables of classes, sites, confusions, false alarms and image labels, then remarks."""
    if answer.boxes is not None:
        _show_figures(console, answer.boxes.figures)
    for figures in answer.image_labels:
        _show_image_level(console, figures)


def write_pictures(answer: DetectorEvaluation, folder: Path) -> list[Path]:
    """Write curves and contact sheets of the worst errors to ``folder``; returns their paths."""
    if answer.boxes is None:
        return []
    return [
        *write_plots(answer.boxes, folder),
        *write_sheets(answer.boxes, answer.collected, answer.collected_negatives, folder),
    ]


def _show_figures(console: Console, figures: DetectorFigures) -> None:
    judged, data = figures.detector, figures.data
    if figures.classes:
        _print_table(
            console,
            f"{judged.name} ({judged.sha256[:12]}) on {data.name}{f', split {data.split}' if data.split else ''}: "
            f"{data.photographs} photographs, {data.sites} sites; score threshold {judged.threshold:g}",
            ("class", "truths", "AP50", "95 % by sites", "by photographs", "AP50:95", *_COUNTS, "ECE", "expected"),
            [
                (
                    one.defect_class, str(one.truths), _share(one.ap50), _format_interval(one.ap50_by_sites),
                    _format_interval(one.ap50_by_photographs), _share(one.ap50_95), *_format_counts(one.operating),
                    _share(one.calibration.ece), _share(one.calibration.expected_precision),
                )
                for one in figures.classes
            ],
        )  # fmt: skip
        ordered = sorted(figures.sites, key=lambda one: (one.defect_class, -one.truths))
        _print_table(
            console,
            "By site" + (f" (the {_MOST_SITES} with most)" if len(ordered) > _MOST_SITES else ""),
            ("site", "class", "photographs", "truths", "AP50", "AP50:95", *_COUNTS),
            [
                (
                    one.site, one.defect_class, str(one.photographs), str(one.truths), _share(one.ap50),
                    _share(one.ap50_95), *_format_counts(one.operating),
                )
                for one in ordered[:_MOST_SITES]
            ],
        )  # fmt: skip
        _print_table(
            console,
            "Confusions",
            ("labelled", "predicted", "boxes (IoU 0.5)"),
            [(one.truth, one.shown, str(one.count)) for one in figures.confusions],
        )
    if figures.negatives is not None:
        _print_table(
            console,
            f"False alarms on photographs without defects: {figures.negatives.name}",
            ("class", "photographs", "m2", "false alarms", "photographs with one", "per 10 m2", "95 %"),
            [
                (
                    "all" if one.defect_class is None else str(one.defect_class), str(one.photographs),
                    "?" if one.area_m2 is None else f"{one.area_m2:.0f}", str(one.count), str(one.with_one),
                    "?" if one.per_10_m2 is None else f"{one.per_10_m2:.3f}",
                    "?" if one.low_per_10_m2 is None else f"{one.low_per_10_m2:.3f} to {one.high_per_10_m2:.3f}",
                )
                for one in figures.negatives.rates
            ],
        )  # fmt: skip
    if figures.megapixels_per_s is not None and figures.photographs_per_s is not None:
        speed = f"{figures.photographs_per_s:.1f} photographs/s, {figures.megapixels_per_s:.1f} Mpx/s"
        console.print(f"speed {speed} (at a low score threshold)", highlight=False)
    for name, count in figures.unlabelled.items():
        console.print(
            f"{count} boxes of {name} predicted on data without labels of that class: not evaluated", highlight=False
        )
    _print_left_out(console, data.left_out)
    for remark in figures.remarks:
        console.print(remark, highlight=False, markup=False, soft_wrap=True)


def _show_image_level(console: Console, figures: ImageLevelFigures) -> None:
    _print_table(
        console,
        f"{figures.detector.name} ({figures.detector.sha256[:12]}) on whole photographs of {figures.name}; without: "
        + ", ".join(figures.sound_folders),
        ("class", "with defect", "without", "AUROC", "95 %", "average precision", "recall", "false alarm share"),
        [
            (
                one.defect_class, str(one.with_defect), str(one.sound), _share(one.auroc),
                _format_interval(one.auroc_by_sites), _share(one.average_precision), _share(one.recall),
                _share(one.false_alarm_share),
            )
            for one in figures.classes
        ],
    )  # fmt: skip
    _print_left_out(console, figures.left_out)


_COUNTS = ("precision", "recall", "F1", "hits / false / missed")


def _format_counts(one: OperatingPoint) -> tuple[str, ...]:
    return (
        _share(one.precision),
        _share(one.recall),
        _share(one.f1),
        f"{one.hits} / {one.false_alarms} / {one.misses}",
    )


def _print_left_out(console: Console, counts: dict[str, int]) -> None:
    for reason, count in counts.items():
        console.print(f"left out: {count} {reason}", highlight=False, markup=False, soft_wrap=True)


def _print_table(console: Console, title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = RichTable(title=escape(title), title_justify="left")
    for index, name in enumerate(head):
        table.add_column(name, justify="left" if index == 0 else "right")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    console.print(table)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _format_interval(interval: BootstrapInterval | None) -> str:
    return "-" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}"
