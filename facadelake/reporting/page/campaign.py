"""The report's tables of the campaign: photographs, checks, as-built against model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pyarrow as pa

from facadelake.reporting.inspection import Inspection
from facadelake.reporting.page.html import Html, render_paragraph, render_table
from schemas.vocabulary import IntegrityOutcome, PhotoOutcome


def _count_values(title: str, words: Sequence[object]) -> Html:
    lines = [
        [str(word if word is not None else "not said").replace("_", " "), n] for word, n in Counter(words).most_common()
    ]
    return render_table([title, "number"], lines, numeric=[1])


def count_outcomes(inspection: Inspection) -> list[Html]:
    """Photographs and detections by outcome."""
    return [
        _count_values("file", inspection.photos.column("photo_outcome").to_pylist()),
        _count_values("role", inspection.photos.column("role").to_pylist()),
        _count_values("pose", inspection.poses.column("pose_source").to_pylist()),
        _count_values("detection", inspection.detections.column("detection_outcome").to_pylist()),
        _count_values("on the surface", inspection.observations.column("observation_outcome").to_pylist()),
    ]


def list_unused_photographs(inspection: Inspection) -> Html:
    """Files that gave no pose, and why."""
    lines = [
        [row["photo_id"], row["photo_outcome"], row["reason"]]
        for row in inspection.photos.to_pylist()
        if row["photo_outcome"] != PhotoOutcome.ACCEPTED
    ]
    lines += [
        [row["photo_id"], row["pose_source"], row["reason"]]
        for row in inspection.poses.to_pylist()
        if row["photo_id"] not in inspection.posed
    ]
    return render_table(["photograph", "outcome", "reason"], lines, caption="Not used") if lines else Html("")


def summarise_checks(checks: pa.Table) -> list[Html]:
    """Expectations met per table, and those that were not."""
    rows = checks.to_pylist()
    failed = [row for row in rows if not row["passed"]]
    passed = Counter(row["table_name"] for row in rows if row["passed"])
    totals = Counter(row["table_name"] for row in rows)
    good, bad = Html('<span class="good">passed</span>'), Html('<span class="bad">failed</span>')
    summary = [
        [name, f"{passed[name]} of {total}", good if passed[name] == total else bad]
        for name, total in sorted(totals.items())
    ]
    pieces = [render_table(["table", "expectations met", ""], summary)]
    if failed:
        lines = [[r["table_name"], r["column_name"], r["expectation"], r["unexpected"], r["detail"]] for r in failed]
        pieces.append(
            render_table(["table", "column", "expectation", "rows", "detail"], lines, caption="Not met", numeric=[3])
        )
    return pieces


def describe_integrity(views: pa.Table) -> Html:
    """How alike the as-built surface and the model are, in a sentence."""
    compared = [row for row in views.to_pylist() if row["integrity_outcome"] == IntegrityOutcome.COMPARED]
    if not compared:
        return render_paragraph("The as-built surface could be compared with the model in no view.")
    ssim = sorted(row["ssim"] for row in compared if row["ssim"] is not None)
    if not ssim:
        return render_paragraph(
            f"As-built against model: {len(compared)} of {len(views)} views compared, none has an SSIM."
        )
    return render_paragraph(
        f"As-built against model: structural similarity (SSIM) of depth in {len(compared)} of {len(views)} views, "
        f"median {ssim[len(ssim) // 2]:.2f}, lowest {ssim[0]:.2f}."
    )
