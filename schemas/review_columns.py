"""The columns of table ``reviews`` that no other table has."""

from __future__ import annotations

from schemas.column_type import real, text, time
from schemas.vocabulary import DefectClass, Verdict

REVIEW_COLUMNS = [
    text("review_id", "one review"),
    text("subject", "the reviewed place: photograph, box and class; the latest review of a subject counts"),
    text("verdict", "verdict of the reviewer", Verdict),
    text("reviewed_class", "class given by the detector; empty for a missed defect", DefectClass),
    real("reviewed_box_x_px", "px", "left edge of the reviewed box; empty for a missed defect"),
    real("reviewed_box_y_px", "px", "its top edge"),
    real("reviewed_box_width_px", "px", "its width"),
    real("reviewed_box_height_px", "px", "its height"),
    text("reviewer", "name of the reviewer"),
    time("reviewed_at", "time of the review's commit"),
    text("note", "remark of the reviewer"),
]
