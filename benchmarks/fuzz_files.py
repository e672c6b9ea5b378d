"""Fuzz of control point files and COCO files: no traceback, and nothing read otherwise than it was written.

The oracle is what was written: every file is made from known marks or boxes, written in one of the many ways of other
programs (paths, quotes, case, blanks, digits; ids as numbers or text, rotations, EXIF's turned views, corners), and
sometimes with a mistake whose refusal is expected. What is read must be what was meant, or be refused with words. A
second round destroys the bytes, and asks for an error of the input or a table.

    python -m benchmarks.fuzz_files --inputs 10000
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings

from benchmarks.drawn_coco_files import Stored, check_coco_file, coco_files, destroyed_coco, make_photos
from benchmarks.drawn_control_files import (
    SIZE,
    STEMS,
    SUFFIXES,
    Tally,
    check_control_file,
    control_files,
    destroyed_control,
)
from facadelake.core.errors import InputDataError
from facadelake.detection.coco import import_coco
from facadelake.georeferencing.gcp.control_points import match_marks, read_surveyed_points


def run(inputs: int) -> Tally:
    """All rounds, a quarter of the inputs each. A traceback ends the run; what is wrong is collected."""
    tally = Tally(outcomes=Counter(), wrong=[])
    share = max(1, inputs // 4)
    rules = settings(
        max_examples=share, deadline=None, database=None, phases=[Phase.generate], derandomize=True,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)

        @rules
        @given(control_files())
        def read_control(case: tuple[list[str], str, dict[str, Any]]) -> None:
            check_control_file(folder, *case, tally)

        @rules
        @given(coco_files())
        def read_coco(case: tuple[list[Stored], dict[str, Any], dict[str, Any]]) -> None:
            check_coco_file(folder, *case, tally)

        @rules
        @given(destroyed_control())
        def read_destroyed_control(data: bytes) -> None:
            path = folder / "gcp_list.txt"
            path.write_bytes(data)
            try:
                points = match_marks(read_surveyed_points(path), ["multiview/DJI_0001.JPG"]).points
            except InputDataError:
                tally.outcomes["destroyed control points refused"] += 1
                return
            tally.outcomes["destroyed control points read"] += 1
            if not all(math.isfinite(value) for point in points for value in (point.x, point.y, point.z)):
                tally.wrong.append(f"coordinates that are not finite: {data!r}")

        @rules
        @given(destroyed_coco())
        def read_destroyed_coco(data: bytes) -> None:
            path = folder / "boxes.json"
            path.write_bytes(data)
            photos = [Stored(f"{f}/{s}{x}".lstrip("/"), 1) for f in ("multiview", "") for s in STEMS for x in SUFFIXES]
            try:
                rows = import_coco(path, make_photos(photos), class_names={}).to_pylist()
            except InputDataError:
                tally.outcomes["destroyed COCO refused"] += 1
                return
            for row in rows:
                tally.outcomes[f"destroyed boxes {row['detection_outcome']}"] += 1
                if row["detection_outcome"] == "accepted" and not (
                    0 <= row["box_x_px"] <= row["box_x_px"] + row["box_width_px"] <= SIZE[0] + 1e-6
                    and 0 <= row["box_y_px"] <= row["box_y_px"] + row["box_height_px"] <= SIZE[1] + 1e-6
                ):
                    tally.wrong.append(f"a box outside its photograph was accepted: {row}")

        for part in (read_control, read_coco, read_destroyed_control, read_destroyed_coco):
            part()
    return tally


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=10_000)
    arguments = parser.parse_args()
    begin = time.perf_counter()
    tally = run(arguments.inputs)
    for name, count in sorted(tally.outcomes.items()):
        print(f"{count:8,}  {name}")
    print(f"{arguments.inputs:,} inputs in {time.perf_counter() - begin:.0f} s; {len(tally.wrong)} wrong")
    for one in tally.wrong[:5]:
        print(f"\n{one}")
    raise SystemExit(bool(tally.wrong))


if __name__ == "__main__":
    main()
