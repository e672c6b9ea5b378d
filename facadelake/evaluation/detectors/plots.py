"""Plots of a detector's evaluation: precision over recall, reliability of scores, sites, false alarms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from facadelake.evaluation.detectors.average_precision import IOU_THRESHOLDS, RECALLS, compute_precision_at_recalls
from facadelake.evaluation.detectors.calibration import BINS
from facadelake.evaluation.detectors.figures import BoxEvaluation
from facadelake.evaluation.plot_style import format_axes
from schemas.vocabulary import DefectClass

_DPI = 130
# Colours of Okabe and Ito 2008, with a line style each for prints without colour.
_STYLE = {
    DefectClass.CRACK: ("#d55e00", "solid"),
    DefectClass.SPALLING: ("#0072b2", "dashed"),
    DefectClass.MOISTURE: ("#009e73", "dotted"),
}
_GOAL_PER_10_M2 = 1.0


def write_plots(evaluation: BoxEvaluation, folder: Path) -> list[Path]:
    """Write the plots as PNG into ``folder`` and return their paths; a plot without samples is not written.

    ``precision_recall``, ``reliability``, ``sites`` and, with photographs without defects, ``false_alarms``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = evaluation.figures
    written = []
    for name, title, draw in (
        ("precision_recall", "precision over recall", _plot_precision_recall),
        ("reliability", "reliability of scores", _plot_reliability),
        ("sites", "by site", _plot_sites),
        ("false_alarms", "false alarms by threshold", _plot_false_alarms),
    ):
        figure = Figure(dpi=_DPI, facecolor="white", layout="constrained")
        FigureCanvasAgg(figure)
        if draw(figure, evaluation):
            data = figures.data.name or (figures.negatives.name if figures.negatives else "")
            subject = f"{figures.detector.name} on {data}"
            figure.suptitle(f"{subject}: {title}", fontsize=10, ha="left", x=0.01, parse_math=False)
            path = folder / f"{name}.png"
            figure.savefig(path)
            written.append(path)
    return written


def _plot_precision_recall(figure: Figure, evaluation: BoxEvaluation) -> bool:
    """One panel a class: the precision envelope at IoU 0.5 and 0.75, and the operating point."""
    known = [one for one in evaluation.figures.classes if one.truths]
    if not known:
        return False
    figure.set_size_inches(max(5.2, 4.4 * len(known)), 4.4)
    for axes, one in zip(figure.subplots(1, len(known), squeeze=False)[0], known, strict=True):
        colour, _ = _STYLE[one.defect_class]
        matches = evaluation.matches_above_floor[one.defect_class]
        for iou, line in ((0.5, "solid"), (0.75, "dotted")):
            curve = compute_precision_at_recalls(matches, int(np.argmin(np.abs(IOU_THRESHOLDS - iou))))
            label = f"IoU {iou:g}: AP {curve.mean():.3f}"
            axes.step(RECALLS, curve, where="post", color=colour, linestyle=line, label=label)
        counts = one.operating
        if counts.precision is not None and counts.recall is not None:
            axes.plot(
                counts.recall, counts.precision, "o", color="#000000",
                label=f"score ≥ {evaluation.figures.detector.threshold:.2f}: "
                f"precision {counts.precision:.2f}, recall {counts.recall:.2f}",
            )  # fmt: skip
        axes.set_xlim(0, 1.01)
        axes.set_ylim(0, 1.02)
        axes.set_title(f"{one.defect_class}: {one.truths} in {one.photographs} photographs", fontsize=9)
        axes.legend(fontsize=8)
        format_axes(axes, "recall", "precision")
    return True


def _plot_reliability(figure: Figure, evaluation: BoxEvaluation) -> bool:
    """Precision by score, and the number of boxes by score."""
    known = [one for one in evaluation.figures.classes if one.calibration.count]
    if not known:
        return False
    figure.set_size_inches(6.4, 6.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.plot([0, 1], [0, 1], color="#000000", linewidth=1.0, label="calibrated")
    for k, one in enumerate(known):
        colour, line = _STYLE[one.defect_class]
        calibration = one.calibration
        error = f"ECE {calibration.ece:.3f}"
        if calibration.ece_shown is not None:
            error += f", at the threshold {calibration.ece_shown:.3f}"
        bins = calibration.bins
        upper.plot(
            [b.mean_score for b in bins], [b.precision for b in bins], marker="o", color=colour, linestyle=line,
            label=f"{one.defect_class}: {error}",
        )  # fmt: skip
        width = 0.8 / BINS / len(known)
        lower.bar([b.low + 0.1 / BINS + (k + 0.5) * width for b in bins], [b.count for b in bins], width, color=colour)
    for axes in (upper, lower):
        axes.axvline(evaluation.figures.detector.threshold, color="#999999", linewidth=0.8)
    upper.set_ylim(0, 1.02)
    upper.legend(fontsize=8)
    lower.set_yscale("log")
    format_axes(upper, "", "precision (IoU ≥ 0.5)")
    format_axes(lower, "score (grey: the threshold)", "boxes")
    return True


def _plot_sites(figure: Figure, evaluation: BoxEvaluation) -> bool:
    """AP50 of each site with its number of labelled boxes, and of all sites with its interval by sites."""
    known = [one for one in evaluation.figures.sites if one.ap50 is not None]
    if len({one.site for one in known}) < 2:
        return False
    figure.set_size_inches(8.0, 1.4 + 0.27 * (len(known) + len(evaluation.figures.classes)))
    axes = figure.subplots()
    names, row = [], 0
    for of_class in evaluation.figures.classes:
        colour, _ = _STYLE[of_class.defect_class]
        if of_class.ap50 is None:
            continue
        interval = of_class.ap50_by_sites
        axes.plot(of_class.ap50, row, "D", color=colour)
        if interval is not None:
            axes.plot([interval.low, interval.high], [row, row], color=colour, linewidth=2)
        names.append(f"{of_class.defect_class}, all sites: {of_class.truths} in {of_class.photographs}")
        row += 1
        for one in sorted(known, key=lambda site: -site.truths):
            if one.defect_class is not of_class.defect_class or one.ap50 is None:
                continue
            axes.barh(row, one.ap50, height=0.6, color=colour, alpha=0.35)
            axes.plot(one.ap50, row, "|", color=colour, markersize=9)
            names.append(f"{one.site}: {one.truths} in {one.photographs}")
            row += 1
    axes.set_yticks(range(row), names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.01)
    format_axes(axes, "AP50 (diamond: all sites, line: bootstrap interval of 95 % by sites)", "")
    return True


def _plot_false_alarms(figure: Figure, evaluation: BoxEvaluation) -> bool:
    """Rate of false alarms by threshold, with the detector's threshold and the goal."""
    alarms = evaluation.figures.negatives
    if alarms is None:
        return False
    figure.set_size_inches(6.4, 4.4)
    axes = figure.subplots()
    known = alarms.rates[0].area_m2 is not None
    values = [one.per_photograph if one.per_10_m2 is None else one.per_10_m2 for one in alarms.by_threshold]
    axes.step([one.score for one in alarms.by_threshold], values, where="mid", color="#d55e00", marker=".")
    axes.axvline(evaluation.figures.detector.threshold, color="#999999", linewidth=0.8)
    if known:
        axes.axhline(_GOAL_PER_10_M2, color="#000000", linewidth=0.8, linestyle="dotted")
    axes.set_yscale("symlog", linthresh=0.01)
    axes.set_ylim(bottom=0)
    gsd = "" if alarms.gsd_mm is None else f" at {alarms.gsd_mm:.1f} mm/px"
    area = f"{alarms.rates[0].area_m2:.0f} m² of facade{gsd}" if known else f"{alarms.rates[0].photographs} photographs"
    axes.set_title(f"{alarms.name}: {area}", fontsize=9, parse_math=False)
    label = "false alarms per 10 m² (dotted: the goal)" if known else "false alarms per photograph"
    format_axes(axes, "threshold of the score (grey: that of the detector)", label)
    return True
