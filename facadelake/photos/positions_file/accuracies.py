"""The accuracies of a positions file: as its columns or its solution state them, and whether they can be metres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from facadelake.core.errors import InputDataError
from facadelake.photos.position_sigma import SIGMA_DRONE, SIGMA_RTK_FIXED, SIGMA_RTK_FLOAT, PositionSigma
from facadelake.photos.positions_file.columns import SIGMAS, PositionColumns
from facadelake.photos.positions_file.numbers import parse_number

# RTKLIB: 1 fixed, 2 float, 3 SBAS, 4 DGPS, 5 single, 6 PPP.
_FIXED = 1.0
_SIGMA_BY_QUALITY = {_FIXED: SIGMA_RTK_FIXED, 2.0: SIGMA_RTK_FLOAT}
# No receiver states more; fixed solutions state centimetres; those without corrections a metre or more.
_NO_POSITION_M = 100.0
_NO_FIXED_M = 1.0
_UNCORRECTED_M = 1.0


@dataclass(frozen=True, kw_only=True)
class StatedSigma:
    """The sigma of a line, what it is taken from, and the warnings."""

    sigma: PositionSigma
    evidence: str
    warnings: tuple[str, ...] = ()


def read_sigma(
    values: Mapping[str, str], columns: PositionColumns, path: Path, assumed: PositionSigma | None
) -> StatedSigma:
    """The sigma of a line by its columns, its RTKLIB quality, the portfolio, or assumed; and which of them it is.

    Args:
        values: the fields of the line by kind.
        columns: the columns of the file.
        path: the file, for warnings.
        assumed: sigma that the portfolio states; None where it states none.

    Returns:
        the sigma. An accuracy that is none, such as 0 or nan, counts as not stated, with a warning.
    """
    stated = {kind: _read_stated(values.get(kind, ""), columns, kind) for kind in SIGMAS}
    warnings = tuple(
        f"{path.name}: {columns.names[kind]} '{values[kind][:20]}' is no accuracy; taken as not stated"
        for kind in SIGMAS
        if values.get(kind, "") and math.isnan(stated[kind])
    )
    both = [stated[kind] for kind in ("east", "north") if stated[kind] > 0]
    horizontal_m = max(both) if len(both) == 2 else stated["horizontal"]
    vertical_m = stated["vertical"]
    if horizontal_m > 0 and vertical_m > 0:
        sigma = PositionSigma(horizontal_m=horizontal_m, vertical_m=vertical_m)
        evidence = f"stated sigma {sigma.horizontal_m:g}/{sigma.vertical_m:g} m"
        return StatedSigma(sigma=sigma, evidence=evidence, warnings=warnings)
    quality = parse_number(values.get("quality", ""), columns.delimiter)
    if math.isfinite(quality):
        other, evidence = _SIGMA_BY_QUALITY.get(quality, SIGMA_DRONE), f"quality {quality:g}"
    elif assumed is not None:
        other, evidence = assumed, "sigma of the portfolio"
    else:
        other = SIGMA_DRONE
        evidence = f"taken as {SIGMA_DRONE.horizontal_m:g}/{SIGMA_DRONE.vertical_m:g} m"
        what = "accuracy of the height" if horizontal_m > 0 else "accuracy"
        warnings += (f"{path.name} states no {what}; {evidence}",)
    if not any(value > 0 for value in stated.values()):
        return StatedSigma(sigma=other, evidence=evidence, warnings=warnings)
    # What is stated of one axis counts, and the others are no better.
    sigma = PositionSigma(
        horizontal_m=horizontal_m if horizontal_m > 0 else max(other.horizontal_m, *both, 0.0),
        vertical_m=vertical_m if vertical_m > 0 else max(other.vertical_m, *(s for s in [horizontal_m] if s > 0), 0.0),
    )
    evidence = f"stated in part, {evidence}: sigma {sigma.horizontal_m:g}/{sigma.vertical_m:g} m"
    return StatedSigma(sigma=sigma, evidence=evidence, warnings=warnings)


def _read_stated(text: str, columns: PositionColumns, kind: str) -> float:
    number = parse_number(text, columns.delimiter) * columns.sigma_factor.get(kind, 1.0)
    return number if number > 0 else math.nan


def check_unit(path: Path, columns: PositionColumns, lines: Sequence[Mapping[str, str]]) -> str:
    """A remark where accuracies without a unit may be millimetres or centimetres; empty where they are metres.

    Args:
        path: the file, for messages.
        columns: its columns.
        lines: the fields of its lines by kind.

    Returns:
        the remark.

    Raises:
        InputDataError: they cannot be metres.
    """
    plain = [kind for kind in SIGMAS if kind in columns.index and kind not in columns.states_unit]
    stated = {
        kind: median(numbers)
        for kind in plain
        if (numbers := [n for line in lines if (n := _read_stated(line.get(kind, ""), columns, kind)) > 0])
    }
    if not stated:
        return ""
    kind = max(stated, key=lambda kind: stated[kind])
    value, name = stated[kind], columns.names[kind]
    qualities = [parse_number(line.get("quality", ""), columns.delimiter) for line in lines]
    fixed = qualities and sum(quality == _FIXED for quality in qualities) > len(qualities) / 2
    found = f"column '{name}' states no unit, and its median is {value:g}"
    meanings = f"in mm this is {value / 1000:g} m, in cm {value / 100:g} m"
    remedy = f"write the unit into its name, such as '{name}_mm', '{name}_cm' or '{name}_m'"
    if value > _NO_POSITION_M or (fixed and value > _NO_FIXED_M):
        limit = f"fixed solutions (Q 1) have less than {_NO_FIXED_M:g} m" if fixed else f"limit {_NO_POSITION_M:g} m"
        raise InputDataError(
            f"the positions file {path}: {found}, which is no accuracy in m ({limit}); {meanings}: {remedy}"
        )
    if value >= _UNCORRECTED_M:
        return f"{path.name}: {found}; taken as m, the accuracy of a receiver without corrections; {meanings}: {remedy}"
    return ""
