"""The coordinate operation of PROJ between two CRSs, chosen for a place, with its stated accuracy.

PROJ lists several operations between two datums; which is right depends on the place. The one is taken whose area of
use contains the place and whose stated accuracy is best. Ballpark operations, which ignore the shift between datums,
are never taken.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyproj
from pyproj.transformer import AreaOfInterest, TransformerGroup

from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs import get_crs_name
from facadelake.core.proj.grids import describe_grid_installation, use_installed_grids

use_installed_grids()

# Operations whose accuracy PROJ does not know are mostly early shifts by three parameters; of those with a stated
# accuracy, nine in ten state 25 m or better.
UNKNOWN_ACCURACY_M = 25.0
METRES_PER_DEGREE = 111_320.0
_INVERSE = "Inverse of "
# EPSG states 1 to 2 m between WGS 84 and ETRS89, NAD83(2011) and their like.
_MODERN_ACCURACY_M = 2.0


@dataclass(frozen=True, kw_only=True)
class MissingOperation:
    """An operation that cannot be used because ``grids`` are not installed; ``accuracy_m`` is None where unknown."""

    name: str
    accuracy_m: float | None
    grids: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class PlacedOperation:
    """The operation between two CRSs for a place.

    ``accuracy_m``: as PROJ's database states it, 0 between CRSs of one datum, None where it is unknown.
    ``ambiguity_m``: distance at the place between its result and those of others of equal accuracy. ``grids``: those it
    uses. ``better_missing``: the best operation, where it is more accurate and its grids are not installed.
    """

    source: str
    target: str
    name: str
    accuracy_m: float | None
    ambiguity_m: float
    grids: tuple[str, ...]
    better_missing: MissingOperation | None
    transformer: pyproj.Transformer

    @property
    def sigma_m(self) -> float:
        """One sigma of each axis: the stated accuracy, at least the ambiguity; 25 m where PROJ states none."""
        return max(UNKNOWN_ACCURACY_M if self.accuracy_m is None else self.accuracy_m, self.ambiguity_m)

    @property
    def is_inverse(self) -> bool:
        """Whether all of its steps are inverses of operations as EPSG defines them."""
        return all(step.startswith(_INVERSE) for step in self.name.split(" + "))

    def is_inverse_of(self, other: PlacedOperation) -> bool:
        """Whether it has the steps of the other one, backwards."""
        steps, others = ([step.removeprefix(_INVERSE) for step in one.name.split(" + ")] for one in (self, other))
        return steps == others[::-1]

    def describe(self) -> str:
        """The operation and its accuracy in words."""
        accuracy = (
            f"accuracy unknown to PROJ, {UNKNOWN_ACCURACY_M:g} m assumed"
            if self.accuracy_m is None
            else f"accuracy {self.accuracy_m:g} m"
        )
        ambiguity = (
            f", another of equal accuracy differs by {self.ambiguity_m:.2g} m here"
            if self.ambiguity_m > (self.accuracy_m or 0.0) > 0
            else ""
        )
        return f"{self.name} ({accuracy}{ambiguity})"


@lru_cache(maxsize=256)
def place_operation(source: pyproj.CRS, target: pyproj.CRS, lon_deg: float, lat_deg: float) -> PlacedOperation:
    """The best available operation for a place.

    Args:
        source: the CRS to transform from.
        target: the CRS to transform to.
        lon_deg: longitude of the place.
        lat_deg: latitude of the place.

    Returns:
        the operation; whether a better one is missing its grids.

    Raises:
        GeoreferenceError: PROJ has no operation for the place, or the grids of all of them are missing.
    """
    group = _list_operations(source, target, lon_deg, lat_deg)
    usable = [one for one in group.transformers if _contains(one.area_of_use, lon_deg, lat_deg)]
    missing = sorted(
        (
            MissingOperation(
                name=_name_datum_steps(one.name),
                accuracy_m=_read_accuracy(one.accuracy),
                grids=tuple(sorted({grid.short_name for grid in one.grids if not grid.available})),
            )
            for one in group.unavailable_operations
            if _contains(one.area_of_use, lon_deg, lat_deg)
        ),
        key=lambda one: _rank_accuracy(one.accuracy_m),
    )
    if not usable:
        raise GeoreferenceError(_describe_unavailable(source, target, lon_deg, lat_deg, missing))
    best = min(usable, key=lambda one: _rank_accuracy(_read_accuracy(one.accuracy)))
    accuracy_m = _read_accuracy(best.accuracy)
    equal = [one for one in usable if one is not best and _read_accuracy(one.accuracy) == accuracy_m]
    better = [one for one in missing if _rank_accuracy(one.accuracy_m) < _rank_accuracy(accuracy_m)]
    return PlacedOperation(
        source=get_crs_name(source),
        target=get_crs_name(target),
        name=_name_datum_steps(best.description),
        accuracy_m=accuracy_m,
        ambiguity_m=_measure_ambiguity(best, equal, source, lon_deg, lat_deg) if accuracy_m != 0.0 else 0.0,
        grids=tuple(sorted({grid.short_name for step in best.operations or () for grid in step.grids})),
        better_missing=better[0] if better else None,
        transformer=best,
    )


def require_best(operation: PlacedOperation, accepted_accuracy_m: float | None) -> None:
    """Refuse an operation where a better one lacks its grid, unless its accuracy is accepted.

    Raises GeoreferenceError that names the grid, how to install it, and the key that accepts the operation.
    """
    better = operation.better_missing
    if better is None or (accepted_accuracy_m is not None and operation.sigma_m <= accepted_accuracy_m):
        return
    accepted = "" if accepted_accuracy_m is None else f" (it is {accepted_accuracy_m:g})"
    raise GeoreferenceError(
        f"the best transformation from {operation.source} to {operation.target} here, {better.name} "
        f"({_format_accuracy(better.accuracy_m)}), needs the grid {', '.join(better.grids) or 'data'}, which is not "
        f"installed: {describe_grid_installation(better.grids)}, or accept {operation.describe()} with "
        f"crs.accept_operation_accuracy_m: {math.ceil(operation.sigma_m * 10) / 10:g} in the portfolio{accepted}"
    )


def describe_poor_operation(operation: PlacedOperation) -> str:
    """Remark on an operation that is worse than those between modern datums, or than one that is not installed."""
    if operation.better_missing is None and operation.sigma_m <= _MODERN_ACCURACY_M:
        return ""
    return f"longitudes and latitudes are those of {operation.describe()}"


def _list_operations(source: pyproj.CRS, target: pyproj.CRS, lon_deg: float, lat_deg: float) -> TransformerGroup:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pyproj warns where the best is unavailable; callers decide
        return TransformerGroup(
            source,
            target,
            always_xy=True,
            allow_ballpark=False,
            area_of_interest=AreaOfInterest(lon_deg, lat_deg, lon_deg, lat_deg),
        )


def _describe_unavailable(
    source: pyproj.CRS, target: pyproj.CRS, lon_deg: float, lat_deg: float, missing: list[MissingOperation]
) -> str:
    """Why there is no operation for a place, and the remedy."""
    text = (
        f"no transformation from {get_crs_name(source)} to {get_crs_name(target)} is available at lon {lon_deg:.2f}, "
        f"lat {lat_deg:.2f}"
    )
    if missing:
        grids = missing[0].grids
        return (
            f"{text}: the grid {', '.join(grids)} of {missing[0].name} ({_format_accuracy(missing[0].accuracy_m)}) is "
            f"not installed; {describe_grid_installation(grids)}, or convert the heights to ellipsoidal ones"
        )
    without = [get_crs_name(crs) for crs in (source, target) if _is_without_datum(crs)]
    # Not "give heights as ellipsoidal": whoever then only renames the datum is wrong by the height of the geoid.
    remedy = "check the CRS and the vertical datum"
    if without:
        remedy = f"{without[0]} states an ellipsoid and no datum: give an EPSG code such as EPSG:25832, or +datum=WGS84"
    return f"{text}: PROJ knows none whose area of use contains the place; {remedy}"


def _is_without_datum(crs: pyproj.CRS) -> bool:
    """Whether a PROJ string names an ellipsoid alone, so that no operation from it is known."""
    datum = (crs.sub_crs_list[0] if crs.is_compound else crs).datum
    return datum is not None and datum.name.lower().startswith("unknown")


def _contains(area: object, lon_deg: float, lat_deg: float) -> bool:
    """Whether a place is in an operation's area of use; True where it states none."""
    if area is None:
        return True
    west, south, east, north = area.bounds  # type: ignore[attr-defined]  # pyproj has two types of areas
    in_lon = west <= lon_deg or lon_deg <= east if west > east else west <= lon_deg <= east
    return bool(in_lon and south <= lat_deg <= north)


def _read_accuracy(accuracy_m: float) -> float | None:
    return None if accuracy_m < 0 else float(accuracy_m)


def _rank_accuracy(accuracy_m: float | None) -> float:
    return UNKNOWN_ACCURACY_M if accuracy_m is None else accuracy_m


def _format_accuracy(accuracy_m: float | None) -> str:
    return "accuracy unknown" if accuracy_m is None else f"{accuracy_m:g} m"


def _name_datum_steps(description: str) -> str:
    """The steps of an operation that change the datum, else the steps that there are."""
    steps = [step.strip() for step in description.split(" + ")]
    names = [step for step in steps if "axis order change" not in step]
    shifts = [step for step in names if " to " in step]
    return " + ".join(shifts or names) or description


def _measure_ambiguity(
    best: pyproj.Transformer, others: list[pyproj.Transformer], source: pyproj.CRS, lon_deg: float, lat_deg: float
) -> float:
    """Largest horizontal distance (m) at a place between results of operations.

    Args:
        best: the operation taken.
        others: the operations to compare it with.
        source: the CRS that they transform from.
        lon_deg: longitude of the place.
        lat_deg: latitude of the place.

    Returns:
        the distance; 0 without others.
    """
    horizontal = source.sub_crs_list[0] if source.is_compound else source
    if not others or horizontal.is_geocentric:
        return 0.0
    x, y = (lon_deg, lat_deg) if horizontal.is_geographic else pyproj.Proj(horizontal)(lon_deg, lat_deg)
    target = best.target_crs
    steps_m = np.array([METRES_PER_DEGREE * math.cos(math.radians(lat_deg)), METRES_PER_DEGREE])
    if target is not None and not target.is_geographic:
        steps_m = np.array([axis.unit_conversion_factor for axis in target.axis_info[:2]])
    results = np.array([one.transform(x, y, 0.0)[:2] for one in (best, *others)])
    distances_m = np.linalg.norm((results[1:] - results[0]) * steps_m, axis=1)
    return float(np.max(distances_m[np.isfinite(distances_m)], initial=0.0))
