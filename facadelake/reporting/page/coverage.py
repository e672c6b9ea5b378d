"""Section of the report on coverage: what the photographs show of the facades, and what is to be flown again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from facadelake.building.surface import Surface
from facadelake.coverage import (
    ALL_STOREYS,
    OBSTACLES,
    CoverageTotal,
    ReflightList,
    describe_contradictions,
    list_reflights,
    summarise_coverage,
)
from facadelake.reporting.elevations.elevation import Elevation
from facadelake.reporting.html import Html, render_figure, render_paragraph, render_table
from facadelake.reporting.inspection import Inspection
from schemas.vocabulary import SurfaceKind

_LISTED_AREAS = 30
_UNKNOWN = (
    "How small a defect would have been found is unknown where neither the detector's model card nor, for imported "
    "boxes, the portfolio declares a recall by size that reaches 90 % (key recall_by_size)."
)


def describe_coverage(inspection: Inspection, elevations: Sequence[Elevation], folder: Path) -> list[Html]:
    """Totals by facade and storey, the coverage layers of the elevations, and the areas that are not imaged."""
    if not len(inspection.coverage):
        return [render_paragraph("Coverage was not measured, or the building has no facades.")]
    totals = summarise_coverage(inspection.coverage)
    is_model = inspection.building.has_surface and inspection.building.surface_kind is not SurfaceKind.AS_BUILT
    surface = Surface(inspection.building) if is_model else None
    reflights = list_reflights(inspection.coverage, surface)
    parts = [render_paragraph(_summarise(totals, inspection)), _list_totals(totals)]
    parts += [
        render_figure(
            elevation.coverage_path, folder, f"coverage of the {elevation.facade.title}",
            f"{elevation.facade.title}: the smallest crack that would have been found, where the detector's recall is "
            "known, else the size of a pixel on the surface; and what is not imaged, with the reason.",
        )
        for elevation in elevations
        if elevation.coverage_path is not None
    ]  # fmt: skip
    contradictions = describe_contradictions(inspection.coverage, inspection.defects)
    if contradictions:
        parts.append(render_paragraph(contradictions))
    return [*parts, *_list_areas(reflights)]


def _summarise(totals: Sequence[CoverageTotal], inspection: Inspection) -> str:
    whole = [total for total in totals if total.storey == ALL_STOREYS]
    surface, imaged = sum(total.surface_m2 for total in whole), sum(total.imaged_m2 for total in whole)
    searched = sum(total.searched_m2 for total in whole)
    text = (
        f"Photographs show {imaged:.0f} of {surface:.0f} m² of walls and openings ({100 * imaged / surface:.1f} %); "
        f"the detector searched {searched:.0f} m². A part counts as imaged where at least one photograph shows it, not "
        "at a grazing angle, and nothing before the wall hides it. Where a part was not imaged or not searched, the "
        "absence of defects says nothing."
    )
    is_as_built = inspection.building.surface_kind is SurfaceKind.AS_BUILT
    if is_as_built:
        text += " The surface is the campaign's own: what no photograph shows is not in it, and is not counted."
    elif inspection.coverage.column("hidden_share").null_count == len(inspection.coverage):
        text += " What stands before the walls is unknown, because there is no as-built surface beside the model."
    if any(total.found_crack_width_mm is None or total.found_patch_mm is None for total in whole):
        text += f" {_UNKNOWN}"
    return text


def _list_totals(totals: Sequence[CoverageTotal]) -> Html:
    rows = [
        [
            total.facade if total.storey == ALL_STOREYS else "",
            "whole facade" if total.storey == ALL_STOREYS else total.storey,
            f"{total.surface_m2:.1f}",
            f"{100 * total.imaged_share:.1f} %",
            f"{100 * total.searched_m2 / total.surface_m2:.1f} %",
            _format(total.gsd_mm, 1),
            _format(total.found_crack_width_mm, 1),
            _format(total.found_patch_mm, 0),
            ", ".join(f"{area:.1f} {OBSTACLES[word]}" for word, area in total.prevented_m2.items() if area >= 0.05),
        ]
        for total in totals
    ]
    heads = [
        "facade", "storey", "surface, m²", "imaged", "searched", "median GSD, mm", "cracks from, mm",
        "patches from, mm", "not imaged, m²",
    ]  # fmt: skip
    caption = "Cracks and patches: the smallest found with 90 % probability on 90 % of the searched surface"
    return render_table(heads, rows, caption=caption, numeric=range(2, 8))


def _format(value: float | None, digits: int) -> str:
    return "unknown" if value is None else f"{value:.{digits}f}"


def _list_areas(reflights: ReflightList) -> list[Html]:
    areas, told = reflights.areas, reflights.describe()
    if not areas:
        return [render_paragraph(f"Nothing is worth flying again. {told}")]
    rows = [
        [
            area.facade,
            ", ".join(area.storeys),
            f"{area.u_min_m:.2f} to {area.u_max_m:.2f}",
            f"{area.v_min_m:.2f} to {area.v_max_m:.2f}",
            f"{area.area_m2:.2f}",
            OBSTACLES[area.outcome],
        ]
        for area in areas[:_LISTED_AREAS]
    ]
    rest = areas[_LISTED_AREAS:]
    caption = "Not imaged, to be flown again"
    if rest:
        caption += f" (the {len(rest)} smallest, {sum(area.area_m2 for area in rest):.1f} m², are not listed)"
    heads = ["facade", "storey", "u, m", "v, m", "m²", "why"]
    return [render_table(heads, rows, caption=caption, numeric=[2, 3, 4]), render_paragraph(told)]
