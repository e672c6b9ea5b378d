"""Fuzz the georeference of IFC models: no traceback, and no position accepted in silence that PROJ contradicts.

    .venv/bin/python -m benchmarks.fuzz_models [--inputs 3000] [--keep FOLDER]

Hypothesis (of the development environment) writes small IFCs whose units, CRS, datum, map conversion, contexts, site
and GlobalIds are stated in many ways, up to three of them wrong, contradictory or missing, and damages the text of
every fourth. The inputs are the same in every run.

The oracle knows what each file states. It reads the map conversion by the standard (ISO 16739-1): coordinates times
MapUnit, without it times the project's unit, and lets pyproj transform them with the operation for the place. A result
is *silently wrong* where a model is accepted and a corner of its wall is more than 1 cm from the oracle's place and no
remark says what was read otherwise; or where the file states what cannot be (outside the area of use, no height of a
building, another size, two statements that differ) and nothing says so.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from pyproj.aoi import AreaOfInterest
from pyproj.transformer import TransformerGroup

from benchmarks.drawn_models import (
    UNITS,
    WALL_M,
    Statements,
    draw_damage,
    draw_statements,
    is_projected_crs,
    write_step,
)
from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.ifc.worker_process import read_ifc_building
from facadelake.core.errors import FacadelakeError, ModelError

_AREA_MARGIN_DEG = 2.0
_PART = 300
_SHOWN_MAX = 20
_TOLERANCE_M = 0.01


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What became of one input; ``fault`` is empty unless it is one."""

    outcome: str
    fault: str = ""


def locate_by_standard(s: Statements) -> tuple[np.ndarray | None, list[str]]:
    """ECEF (n, 3) of the first wall's corners on the ground by the standard's reading, and what cannot be about it."""
    impossible = list(s.contradicts)
    if not is_projected_crs(s.crs):
        return None, impossible
    crs = pyproj.CRS(s.crs)
    crs_m = crs.axis_info[0].unit_conversion_factor
    project_m = UNITS[s.project_unit or "metre"][1]
    unit_m = UNITS[s.map_unit][1] if s.map_unit else project_m
    scale = 1.0 if s.scale is None else s.scale
    x, y = (np.array([0.0, WALL_M[0]]) * s.geometry_factor / project_m * scale * unit_m, np.zeros(2))
    c, n = math.cos(math.radians(s.angle_deg)), math.sin(math.radians(s.angle_deg))
    east = (s.east * unit_m + c * x - n * y) / crs_m
    north = (s.north * unit_m + n * x + c * y) / crs_m
    height_m = s.height * unit_m
    if not -500 <= height_m <= 9000:
        impossible.append("height")
    area = crs.area_of_use
    lon, lat = pyproj.Proj(crs)(east[0], north[0], inverse=True)
    if not (
        math.isfinite(lon)
        and area.west - _AREA_MARGIN_DEG <= lon <= area.east + _AREA_MARGIN_DEG
        and area.south - _AREA_MARGIN_DEG <= lat <= area.north + _AREA_MARGIN_DEG
    ):
        return None, [*impossible, "outside the area of use"]
    group = TransformerGroup(
        crs, pyproj.CRS("EPSG:4979"), always_xy=True, allow_ballpark=False,
        area_of_interest=AreaOfInterest(lon - 0.01, lat - 0.01, lon + 0.01, lat + 0.01),
    )  # fmt: skip
    if not group.transformers:
        return None, [*impossible, "no operation for the place"]
    lon, lat = group.transformers[0].transform(east, north)[:2]
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    ecef = np.column_stack(to_ecef.transform(lon, lat, np.full(2, height_m)))
    length_m = float(np.linalg.norm(ecef[1] - ecef[0]))
    if abs(length_m / WALL_M[0] - 1) > 0.006:  # also where the geometry is in another unit
        impossible.append("size")
    return ecef, impossible


def judge(s: Statements, path: Path) -> Finding:
    """Load the file and compare with the oracle."""
    try:
        building = load_ifc_building(path, settings=IfcModelSettings(workers=1))
    except FacadelakeError as error:
        if not s.changes:
            return Finding(outcome="refused although correct", fault=str(error))
        return Finding(outcome="refused")
    except Exception:
        return Finding(outcome="traceback", fault=traceback.format_exc(limit=-6))
    expected, impossible = locate_by_standard(s)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    geo = building.origin.geo_from_site(building.vertices_site_m)
    found = np.column_stack(to_ecef.transform(*geo.T))
    told = building.remarks
    if s.shared_guid and (len(set(building.elements.column("element_guid").to_pylist())) < 2 or "STEP ids" not in told):
        return Finding(outcome="silently wrong", fault="two walls of one GlobalId are one")
    if expected is not None and not impossible:
        off_m = max(float(np.linalg.norm(found - corner, axis=1).min()) for corner in expected)
        if off_m <= _TOLERANCE_M:
            return Finding(outcome="accepted, as the oracle")
        if _tells_reading(told):
            return Finding(outcome="accepted in another reading, told")
        return Finding(outcome="silently wrong", fault=f"{off_m:.3f} m from the oracle; remarks: {told or 'none'}")
    if _tells_reading(told):
        return Finding(outcome="accepted in another reading, told")
    return Finding(
        outcome="silently wrong", fault=f"accepted although {', '.join(impossible)}; remarks: {told or 'none'}"
    )


def _tells_reading(remarks: str) -> bool:
    """Whether the remarks say that something was not read as the standard says."""
    return any(
        text in remarks
        for text in (
            "is assumed", "are assumed", "is taken as a factor between metres", "MapUnit was used",
            "ConversionFactor was used", "check its length unit", "over the building's", "but near it",
        )
    )  # fmt: skip


def run_part(inputs: int, part: int, skip: int, folder: Path) -> None:
    """Judge the inputs of one part after the first ``skip``, in this process; print each finding as a line of JSON.

    The input at work is ``part-number.ifc`` in ``folder``, where those that show a fault stay.
    """
    number = 0

    def take(s: Statements, text: str, is_damaged: bool) -> None:
        path = folder / f"{part}-{number:04d}.ifc"
        path.write_bytes(text.encode("utf-8"))
        finding = judge(s, path)
        if is_damaged and finding.outcome != "traceback":  # the oracle does not know what the text states
            refused = finding.outcome.startswith("refused")
            finding = Finding(outcome=f"damaged, {'refused' if refused else 'accepted'}")
        if not finding.fault:
            path.unlink()
        print(json.dumps([finding.outcome, f"{s.changes}: {finding.fault}" if finding.fault else ""]), flush=True)

    common = settings(
        max_examples=inputs, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip

    @seed(part)
    @common
    @given(st.data())
    def judge_one(data: st.DataObject) -> None:
        nonlocal number
        s = data.draw(draw_statements())
        text = write_step(s)
        is_damaged = data.draw(st.integers(0, 3)) == 0
        text = data.draw(draw_damage(text)) if is_damaged else text
        number += 1
        if number > skip:
            take(s, text, is_damaged)

    judge_one()


def run(inputs: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Judge the inputs in processes of 300, which ifcopenshell's parser may crash: then the product must say so."""
    outcomes: Counter[str] = Counter()
    faults: list[str] = []
    for part in range(-(-inputs // _PART)):
        size, judged = min(_PART, inputs - part * _PART), 0
        while judged < size:
            command = [sys.executable, "-m", "benchmarks.fuzz_models", "--inputs", str(size), "--part", str(part)]
            command += ["--skip", str(judged), "--keep", str(folder)]
            done = subprocess.run(command, capture_output=True, text=True)
            findings = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]
            outcomes.update(outcome for outcome, _ in findings)
            faults += [fault for _, fault in findings if fault]
            judged += len(findings)
            if done.returncode > 0:
                return outcomes, [*faults, done.stderr[-1000:]]
            if done.returncode == 0:
                break
            judged += 1
            finding = judge_crash(folder / f"{part}-{judged:04d}.ifc")
            outcomes[finding.outcome] += 1
            faults += [finding.fault] if finding.fault else []
    return outcomes, faults


def judge_crash(path: Path) -> Finding:
    """Read a file that ended its process as the product does: that must be an error which names the file."""
    try:
        read_ifc_building(path, settings=IfcModelSettings(workers=1))
    except ModelError as error:
        if str(path) in str(error):
            return Finding(outcome="crashed the parser, refused")
        return Finding(outcome="crashed the parser", fault=f"the message does not name the file: {error}")
    return Finding(outcome="crashed the parser after other files, accepted alone")


def main() -> None:
    """Print outcomes and faults; exit 1 if there is a fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=3000)
    parser.add_argument("--keep", type=Path, help="folder for the inputs that show a fault")
    parser.add_argument("--part", type=int, help="judge one part in this process, and print JSON")
    parser.add_argument("--skip", type=int, default=0, help="inputs of the part that were judged before")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        if arguments.part is not None:
            run_part(arguments.inputs, arguments.part, arguments.skip, folder)
            return
        outcomes, faults = run(arguments.inputs, folder)
    print(f"{sum(outcomes.values())} inputs")
    for outcome, count in outcomes.most_common():
        print(f"  {count:6d}  {outcome}")
    for fault, count in Counter(re.sub(r"[\d.]+", "0", fault) for fault in faults).most_common(_SHOWN_MAX):
        print(f"- {count} x {fault}")
    if faults:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
