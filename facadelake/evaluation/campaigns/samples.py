"""Errors with what is needed to explain them: whose, where, on which surface, how sure the run was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import SchemaError

Row = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionSamples:
    """n positions with a true one.

    ``error_site_m`` (n, 3) found minus true, ``xyz_true_site_m`` (n, 3), ``normal_site`` (n, 3) outward,
    ``covariance_m2`` (3, 3) as the run states it, None where it states none. ``incidence_deg``, ``distance_m``,
    ``deviation_m`` (n,): NaN where a row has none.
    """

    ids: tuple[str, ...]
    targets: tuple[str, ...]
    error_site_m: Float64Array
    xyz_true_site_m: Float64Array
    normal_site: Float64Array
    covariance_m2: tuple[Float64Array | None, ...]
    incidence_deg: Float64Array
    distance_m: Float64Array
    deviation_m: Float64Array

    @property
    def size_m(self) -> Float64Array:
        """3D distances (n,)."""
        size: Float64Array = np.linalg.norm(self.error_site_m, axis=1)
        return size


def collect_position_samples(
    pairs: Sequence[tuple[Row, str]], xyz_true_site_m: Mapping[str, Float64Array], *, key: str
) -> PositionSamples:
    """Rows of ``observations`` or ``defects`` (their id in column ``key``), each with the check point it shows."""
    rows = [row for row, _ in pairs]
    true = np.array([xyz_true_site_m[target] for _, target in pairs], dtype=np.float64).reshape(-1, 3)
    found = _collect_columns(rows, "x_site_m", "y_site_m", "z_site_m")
    return PositionSamples(
        ids=tuple(row[key] for row in rows),
        targets=tuple(target for _, target in pairs),
        error_site_m=found - true,
        xyz_true_site_m=true,
        normal_site=_collect_columns(rows, "normal_x", "normal_y", "normal_z"),
        covariance_m2=tuple(parse_covariance(row[key], row.get("covariance_site")) for row in rows),
        incidence_deg=_collect_columns(rows, "incidence_deg")[:, 0],
        distance_m=_collect_columns(rows, "distance_m")[:, 0],
        deviation_m=_collect_columns(rows, "deviation_from_model_m")[:, 0],
    )


def parse_covariance(name: str, numbers: Sequence[float] | None) -> Float64Array | None:
    """The (3, 3) of a row's nine numbers, m^2. Raises SchemaError for what is no covariance."""
    if numbers is None:
        return None
    whole = np.array(numbers, dtype=np.float64)
    covariance = whole.reshape(3, 3) if whole.size == 9 else np.full((3, 3), np.nan)
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh((covariance + covariance.T) / 2)[0] <= 0:
        raise SchemaError(
            f"the covariance of {name} is not one of a position (9 numbers, positive variances); run the campaign again"
        )
    return covariance


def _collect_columns(rows: Sequence[Row], *names: str) -> Float64Array:
    """Columns as numbers (n, names); NaN for what is empty or not there."""
    values = [[np.nan if row.get(name) is None else row[name] for name in names] for row in rows]
    return np.array(values, dtype=np.float64).reshape(-1, len(names))
