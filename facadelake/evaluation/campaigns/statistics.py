"""Statistics of errors: the same for every figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3


@dataclass(frozen=True, kw_only=True)
class ErrorStatistics:
    """Statistics of ``n`` signed errors or distances; None where ``n`` is 0.

    ``mae``: mean absolute error; ``rmse``: root mean square; ``p95``: 95th percentile of absolute values; ``iqr``:
    interquartile range.
    """

    n: int
    mean: float | None = None
    median: float | None = None
    mae: float | None = None
    rmse: float | None = None
    p95: float | None = None
    iqr: float | None = None

    def convert_to_json(self) -> dict[str, float | int | None]:
        """The fields as keys."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class PositionErrorStatistics(ErrorStatistics):
    """Statistics of 3D errors, and the mean signed error (estimated minus true) along each axis of site."""

    offset_east: float | None = None
    offset_north: float | None = None
    offset_up: float | None = None


@dataclass(frozen=True, kw_only=True)
class SurfaceErrorStatistics:
    """Statistics of position errors: 3D ``distance``, and signed along the outward normal and along the surface."""

    distance: ErrorStatistics
    normal: ErrorStatistics
    horizontal: ErrorStatistics
    vertical: ErrorStatistics

    def convert_to_json(self) -> dict[str, object]:
        """The statistics of the 3D distance, and an object for each direction."""
        parts: Mapping[str, ErrorStatistics] = {
            "normal": self.normal,
            "horizontal": self.horizontal,
            "vertical": self.vertical,
        }
        return {**self.distance.convert_to_json(), **{name: part.convert_to_json() for name, part in parts.items()}}


def compute_statistics(errors: Float64N) -> ErrorStatistics:
    """Statistics of signed errors or distances (n,)."""
    if len(errors) == 0:
        return ErrorStatistics(n=0)
    size = np.abs(errors)
    lower, median, upper = np.percentile(errors, [25, 50, 75])
    return ErrorStatistics(
        n=len(errors),
        mean=float(np.mean(errors)),
        median=float(median),
        mae=float(np.mean(size)),
        rmse=float(np.sqrt(np.mean(errors**2))),
        p95=float(np.percentile(size, 95)),
        iqr=float(upper - lower),
    )


def compute_position_statistics(errors_site_m: Float64Nx3) -> PositionErrorStatistics:
    """Statistics of position errors (n, 3), estimated minus true, m in site."""
    errors = errors_site_m.reshape(-1, 3)
    distance = compute_statistics(np.linalg.norm(errors, axis=1))
    if not distance.n:
        return PositionErrorStatistics(n=0)
    east, north, up = errors.mean(axis=0).tolist()
    return PositionErrorStatistics(**asdict(distance), offset_east=east, offset_north=north, offset_up=up)


def compute_surface_axes(normals: Float64Nx3) -> tuple[Float64Nx3, Float64Nx3]:
    """Directions along surfaces of outward unit ``normals`` (n, 3): horizontal and vertical, (n, 3) each, in site.

    Horizontal points right as seen from outside, vertical up the surface. On a level surface, which has no upward
    direction, they are east and, for one facing up, north.
    """
    horizontal = np.cross([0.0, 0.0, 1.0], normals).reshape(-1, 3)
    length = np.linalg.norm(horizontal, axis=1, keepdims=True)
    level = length[:, 0] < 1e-6
    horizontal = np.where(level[:, None], [1.0, 0.0, 0.0], horizontal / np.where(level[:, None], 1.0, length))
    return horizontal, np.cross(normals, horizontal).reshape(-1, 3)


def compute_surface_statistics(errors: Float64Nx3, normals: Float64Nx3) -> SurfaceErrorStatistics:
    """Statistics of errors (n, 3), estimated minus true, m in site, on surfaces of outward ``normals`` (n, 3)."""
    errors, normals = errors.reshape(-1, 3), normals.reshape(-1, 3)
    if len(normals):
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    horizontal, vertical = compute_surface_axes(normals)
    return SurfaceErrorStatistics(
        distance=compute_statistics(np.linalg.norm(errors, axis=1)),
        normal=compute_statistics((errors * normals).sum(axis=1)),
        horizontal=compute_statistics((errors * horizontal).sum(axis=1)),
        vertical=compute_statistics((errors * vertical).sum(axis=1)),
    )
