"""Sections of the report on the campaign: photographs, checks, comparison of as-built surface and model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pyarrow as pa

from facadelake.reporting.html import Html, render_paragraph, render_table
from facadelake.reporting.inspection import Inspection
from schemas.vocabulary import IntegrityOutcome, PhotoOutcome


def _count_values(title: str, values: Sequence[object]) -> Html:
    """A table of the values with their counts, the most frequent first."""
    rows = [
        [str(value if value is not None else "not stated").replace("_", " "), count]
        for value, count in Counter(values).most_common()
    ]
    return render_table([title, "number"], rows, numeric=[1])


def count_outcomes(inspection: Inspection) -> list[Html]:
    """Tables of the numbers of photographs, poses, detections and observations by outcome."""
    return [
        _count_values("file", inspection.photos.column("photo_outcome").to_pylist()),
        _count_values("role", inspection.photos.column("role").to_pylist()),
        _count_values("pose source", inspection.poses.column("pose_source").to_pylist()),
        _count_values("detection", inspection.detections.column("detection_outcome").to_pylist()),
        _count_values("observation", inspection.observations.column("observation_outcome").to_pylist()),
    ]


def list_unused_photographs(inspection: Inspection) -> Html:
    """Table of the photographs without a pose, with the reasons."""
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
    return (
        render_table(["photograph", "outcome", "reason"], lines, caption="Photographs not used") if lines else Html("")
    )


def list_photographs_with_warnings(inspection: Inspection) -> Html:
    """Table of the photographs whose metadata are damaged, ambiguous or contradictory."""
    lines = [[row["photo_id"], row["prior_warnings"]] for row in inspection.photos.to_pylist() if row["prior_warnings"]]
    return render_table(["photograph", "warnings"], lines, caption="Warnings about metadata") if lines else Html("")


def summarise_checks(checks: pa.Table) -> list[Html]:
    """Tables of the expectations met for each table, and of those not met."""
    rows = checks.to_pylist()
    failed = [row for row in rows if not row["passed"]]
    passed = Counter(row["table_name"] for row in rows if row["passed"])
    totals = Counter(row["table_name"] for row in rows)
    passed_mark, failed_mark = Html('<span class="good">passed</span>'), Html('<span class="bad">failed</span>')
    summary = [
        [name, f"{passed[name]} of {total}", passed_mark if passed[name] == total else failed_mark]
        for name, total in sorted(totals.items())
    ]
    tables = [render_table(["table", "expectations met", ""], summary)]
    if failed:
        lines = [[r["table_name"], r["column_name"], r["expectation"], r["unexpected"], r["detail"]] for r in failed]
        tables.append(
            render_table(
                ["table", "column", "expectation", "rows", "detail"], lines, caption="Expectations not met", numeric=[3]
            )
        )
    return tables


def describe_integrity(views: pa.Table) -> Html:
    """A sentence on the similarity of as-built surface and model."""
    compared = [row for row in views.to_pylist() if row["integrity_outcome"] == IntegrityOutcome.COMPARED]
    if not compared:
        return render_paragraph("As-built surface and model: no view could be compared.")
    ssim = sorted(row["ssim"] for row in compared if row["ssim"] is not None)
    if not ssim:
        return render_paragraph(
            f"As-built surface and model: {len(compared)} of {len(views)} views compared, none with an SSIM."
        )
    return render_paragraph(
        f"As-built surface and model: structural similarity (SSIM) of depth in {len(compared)} of {len(views)} views, "
        f"median {ssim[len(ssim) // 2]:.2f}, minimum {ssim[0]:.2f}."
    )
