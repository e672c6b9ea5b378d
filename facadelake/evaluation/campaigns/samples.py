"""Samples of position errors with their covariance, surface and view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.errors import SchemaError

Row = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionSamples:
    """Errors of n positions with a known true position, in site.

    ``error_site_m`` (n, 3): estimated minus true. ``normal_site`` (n, 3): outward.
    ``covariance_m2``: (3, 3) as the run states it; None where it states none. ``incidence_deg``, ``distance_m``,
    ``deviation_m`` (n,): NaN where a row has no value.
    """

    ids: tuple[str, ...]
    error_site_m: Float64Nx3
    xyz_true_site_m: Float64Nx3
    normal_site: Float64Nx3
    covariance_m2: tuple[Float64x3x3 | None, ...]
    incidence_deg: Float64N
    distance_m: Float64N
    deviation_m: Float64N

    @property
    def size_m(self) -> Float64N:
        """Length (n,) of the 3D errors."""
        size: Float64N = np.linalg.norm(self.error_site_m, axis=1)
        return size


def collect_position_samples(
    pairs: Sequence[tuple[Row, str]], xyz_true_site_m: Mapping[str, Float64x3], *, key: str
) -> PositionSamples:
    """Samples of rows of ``observations`` or ``defects``, each with its check point; ``key``: the column of the id."""
    rows = [row for row, _ in pairs]
    true = np.array([xyz_true_site_m[point] for _, point in pairs], dtype=np.float64).reshape(-1, 3)
    estimated = _collect_columns(rows, "x_site_m", "y_site_m", "z_site_m")
    return PositionSamples(
        ids=tuple(row[key] for row in rows),
        error_site_m=estimated - true,
        xyz_true_site_m=true,
        normal_site=_collect_columns(rows, "normal_x", "normal_y", "normal_z"),
        covariance_m2=tuple(parse_covariance(row[key], row.get("covariance_site")) for row in rows),
        incidence_deg=_collect_columns(rows, "incidence_deg")[:, 0],
        distance_m=_collect_columns(rows, "distance_m")[:, 0],
        deviation_m=_collect_columns(rows, "deviation_from_model_m")[:, 0],
    )


def parse_covariance(name: str, numbers: Sequence[float] | None) -> Float64x3x3 | None:
    """The covariance (3, 3), m^2, of a row's nine numbers. Raises SchemaError where they are not a covariance."""
    if numbers is None:
        return None
    flat = np.array(numbers, dtype=np.float64)
    covariance = flat.reshape(3, 3) if flat.size == 9 else np.full((3, 3), np.nan)
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh((covariance + covariance.T) / 2)[0] <= 0:
        raise SchemaError(
            f"the covariance of {name} is not that of a position (9 numbers, positive definite); run the campaign again"
        )
    return covariance


def _collect_columns(rows: Sequence[Row], *names: str) -> Float64Array:
    """Columns as numbers (n, k), one column a name; NaN where a value or the column is missing."""
    values = [[np.nan if row.get(name) is None else row[name] for name in names] for row in rows]
    return np.array(values, dtype=np.float64).reshape(-1, len(names))
