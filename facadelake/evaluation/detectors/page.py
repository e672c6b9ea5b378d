"""A model's page for people, made of its card: what it is for, what it learned from, how good it was found to be.

After Mitchell et al., Model Cards for Model Reporting, FAT* 2019. Figures come from the card alone; words that no
figure gives (what it is meant for, its limits) come from ``<model>.about.md`` beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from facadelake.core.hashing import hash_file
from facadelake.detection import ModelCard
from facadelake.detection.inference import find_card
from facadelake.evaluation.detectors.card_results import list_evaluations


def render_model_page(model: Path) -> str:
    """The page in Markdown. Raises ModelError where the model has no card."""
    card = find_card(model)
    sha256 = hash_file(model)
    about = model.with_suffix(".about.md")
    own = [one for one in list_evaluations(card.metrics) if one.get("model_sha256") == sha256]
    parts = [
        f"# {card.name}",
        "Made by `facadelake describe-detector` from the model's card; figures are not typed by hand.",
        _render_facts(card, model, sha256),
        about.read_text(encoding="utf-8").strip() if about.is_file() else "",
        _render_training_data(card),
        *(_render_boxes(one) for one in own if one.get("kind") == "boxes"),
        _render_false_alarms([one for one in own if one.get("kind") == "without defects"]),
        _render_image_level([one for one in own if one.get("kind") == "image labels"]),
        "" if own else "## Figures\n\nNone yet: `facadelake evaluate-detector --write-card` measures and writes them.",
        _render_commands(own),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _render_facts(card: ModelCard, model: Path, sha256: str) -> str:
    spec, calibration = card.input, card.score_calibration
    seen_at = " and ".join(f"{gsd:g}" for gsd in spec.gsd_mm)
    rows = [
        ("file", f"`{model.name}`, {model.stat().st_size / 1e6:.1f} MB, SHA-256 `{sha256}`"),
        ("licence of the weights", card.licence),
        ("source", card.source or "not stated"),
        ("classes", ", ".join(card.class_names)),
        ("input", f"{spec.width_px} x {spec.height_px} px, {spec.colour}, {spec.resize}"),
        ("sees a facade at", f"{seen_at} mm a pixel" if seen_at else "whatever the photograph has"),
        ("output layout", str(card.output.layout)),
        ("threshold of the score", f"{card.score_threshold:g}"),
        ("score", _describe_calibration(calibration.slope, calibration.intercept)),
    ]
    return _render_table(("", ""), rows)


def _describe_calibration(slope: float, intercept: float) -> str:
    if (slope, intercept) == (1.0, 0.0):
        return "as the model gives it"
    return f"calibrated: logit(p) = {slope:.3g} logit(score) {intercept:+.3g}"


def _render_training_data(card: ModelCard) -> str:
    if not card.training_data:
        return "## Training data\n\nNot stated in the card."
    return "## Training data\n\n" + "\n".join(f"- {one}" for one in card.training_data)


def _render_boxes(entry: Mapping[str, Any]) -> str:
    named = f"{entry['data']}{', split ' + entry['split'] if entry.get('split') else ''}"
    classes = _render_table(
        (
            "class", "photographs", "defects", "AP50", "95 % by sites", "95 % by photographs", "mean of sites",
            "AP50:95", "precision", "recall", "F1", "ECE", "expected precision",
        ),
        [
            (
                one["class"], one["photographs"], one["truths"], _format_share(one["ap50"]), _format_interval(one["ap50_by_sites"]),
                _format_interval(one["ap50_by_photographs"]), _format_share(one["mean_ap50_of_sites"]), _format_share(one["ap50_95"]),
                _format_share(one["precision"]), _format_share(one["recall"]), _format_share(one["f1"]), _format_share(one["ece"]),
                _format_share(one["expected_precision"]),
            )
            for one in entry["classes"]
        ],
    )  # fmt: skip
    sites = _render_table(
        ("site", "class", "photographs", "defects", "AP50", "AP50:95", "precision", "recall"),
        [
            (
                one["site"], one["class"], one["photographs"], one["truths"], _format_share(one["ap50"]),
                _format_share(one["ap50_95"]), _format_share(one["precision"]), _format_share(one["recall"]),
            )
            for one in sorted(entry["by_site"], key=lambda one: (one["class"], -one["truths"]))
        ],
    )  # fmt: skip
    lead = (
        f"{entry['photographs']} photographs of {entry['sites']} sites. AP by pycocotools; precision, recall and F1 at "
        f"the threshold {entry['threshold']:g} and an IoU of 0.5; ECE: expected calibration error of the scores."
    )
    remarks = "\n".join(f"- {one}" for one in entry.get("remarks", ()))
    parts = [f"## Boxes: {named}", lead, classes, remarks, "By site:", sites]
    return "\n\n".join(part for part in parts if part)


def _render_false_alarms(entries: Sequence[Mapping[str, Any]]) -> str:
    if not entries:
        return ""
    rows = [
        (
            entry["data"] + (f", split {entry['split']}" if entry.get("split") else ""),
            rate["class"],
            entry["photographs"],
            "unknown" if entry["area_m2"] is None else f"{entry['area_m2']:.0f}",
            "unknown" if entry.get("gsd_mm") is None else f"{entry['gsd_mm']:.1f}",
            rate["false_alarms"],
            rate["photographs_with_one"],
            "" if rate["per_10_m2"] is None else f"{rate['per_10_m2']:.2f}",
            _format_interval(rate["per_10_m2_interval"]),
        )
        for entry in entries
        for rate in entry["rates"]
    ]
    head = (
        "photographs of",
        "class",
        "photographs",
        "m²",
        "mm a pixel",
        "false alarms",
        "photographs with one",
        "per 10 m²",
        "95 %",
    )
    return f"## False alarms where there is no defect\n\n{_render_table(head, rows)}"


def _render_image_level(entries: Sequence[Mapping[str, Any]]) -> str:
    if not entries:
        return ""
    rows = [
        (
            entry["data"], one["class"], one["with_defect"], one["sound"], _format_share(one["auroc"]),
            _format_interval(one["auroc_by_sites"]), _format_share(one["average_precision"]), _format_share(one["recall"]),
            _format_share(one["false_alarm_share"]),
        )
        for entry in entries
        for one in entry["classes"]
    ]  # fmt: skip
    head = (
        "photographs of", "class", "with it", "sound", "AUROC", "95 %", "average precision", "share found",
        "share of sound ones with an alarm",
    )  # fmt: skip
    lead = "By the best score of a photograph that is labelled as a whole (AUROC 0.5 is guessing):"
    return f"## Photographs labelled as a whole\n\n{lead}\n\n{_render_table(head, rows)}"


def _render_commands(entries: Sequence[Mapping[str, Any]]) -> str:
    lines = dict.fromkeys(f"{one['date']}: `{one['command']}`" for one in entries)
    return "## How it was measured\n\n" + "\n".join(f"- {line}" for line in lines) if lines else ""


def _format_share(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _format_interval(values: Sequence[float] | None) -> str:
    return "" if values is None else f"{values[0]:.2f} to {values[1]:.2f}"


def _render_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)
