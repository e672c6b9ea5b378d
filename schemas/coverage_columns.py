"""The columns of table ``coverage`` that no other table has."""

from __future__ import annotations

from schemas.column_type import Column, Kind, count, real, text
from schemas.vocabulary import CoverageOutcome

COVERAGE_COLUMNS = [
    Column(
        name="cell_column",
        kind=Kind.INTEGER,
        meaning="number of the cell along u, 0.25 m wide: u_min_m to u_max_m is within 0.25 times it and the next",
    ),
    Column(name="cell_row", kind=Kind.INTEGER, meaning="number of the cell along v, 0.25 m high, as cell_column"),
    count(
        "cell_layer",
        "0 for the outermost surface of the element in the cell, 1, ... for those more than 1 m behind it",
    ),
    text("coverage_outcome", "whether a photograph shows the cell, else what prevents it", CoverageOutcome),
    real("u_min_m", "m", "left edge of the part of the cell on the element, as seen from outside (frame facade)"),
    real("u_max_m", "m", "its right edge"),
    real("v_min_m", "m", "its lower edge: up from the site's origin"),
    real("v_max_m", "m", "its upper edge"),
    count("imaged_count", "photographs that show at least half of the cell"),
    count("searched_count", "those of them that the detector processed, or whose boxes the imported file lists"),
    real(
        "hidden_share",
        "",
        "share of the views of the cell that something before the wall hides, or an exclusion mask covers; empty where "
        "no photograph looks at it, and without an as-built surface beside the model, which shows such things",
        0,
        1,
    ),
    real(
        "blur_px",
        "px",
        "standard deviation of the point spread of best_photo_id, measured at edges near the cell; empty where it has "
        "too few, which is taken as 0.95 px",
        0,
    ),
    real(
        "found_crack_width_mm",
        "mm",
        "smallest crack width that the detector finds with a probability of 90 % in one of the photographs; empty "
        "where it did not search the cell, or its recall by size is unknown or never reaches 90 %",
        0,
    ),
    real(
        "found_patch_mm",
        "mm",
        "root of the area of the smallest spalling or moisture that it finds so; empty as found_crack_width_mm",
        0,
    ),
]
