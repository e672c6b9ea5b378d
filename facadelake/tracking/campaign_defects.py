"""The defects of one campaign as arrays: the input of tracking."""

from __future__ import annotations

from dataclasses import dataclass, fields
from datetime import datetime

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, Float64Nx3x3, RowIndices
from schemas.vocabulary import DefectClass

CLASSES = [str(name) for name in DefectClass]


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectArrays:
    """Defects (n rows). ``defect_class`` (n,) are codes into ``CLASSES``.

    ``xyz_site_m`` (n, 3) with ``covariance_m2`` (n, 3, 3), outward ``normal_site`` (n, 3), and the extents ``width_m``
    (horizontal) and ``height_m`` (n,) on the surface. ``facade`` (n,) names.
    """

    defect_id: np.ndarray
    defect_class: RowIndices
    facade: np.ndarray
    xyz_site_m: Float64Nx3
    covariance_m2: Float64Nx3x3
    normal_site: Float64Nx3
    width_m: Float64N
    height_m: Float64N

    def __len__(self) -> int:
        return len(self.defect_class)

    @property
    def extent_m(self) -> Float64N:
        """Diagonal of the extents (n,)."""
        diagonal: Float64N = np.hypot(self.width_m, self.height_m)
        return diagonal

    def take(self, rows: RowIndices | BoolArray) -> DefectArrays:
        """Some of the defects."""
        return DefectArrays(**{field.name: getattr(self, field.name)[rows] for field in fields(DefectArrays)})


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedCampaign:
    """The defects of one campaign. ``frame_sigma_m``: one sigma of its georeferencing, largest axis."""

    campaign_id: str
    captured_at: datetime
    frame_sigma_m: float
    defects: DefectArrays


def concatenate_defects(first: DefectArrays, second: DefectArrays) -> DefectArrays:
    """Defects one after the other."""
    return DefectArrays(
        **{f.name: np.concatenate([getattr(first, f.name), getattr(second, f.name)]) for f in fields(DefectArrays)}
    )


def read_defects(table: pa.Table) -> DefectArrays:
    """Rows of table ``defects`` as arrays, in their order. A defect without a covariance has that of its sigmas."""

    def read(*names: str) -> np.ndarray:
        return np.column_stack([table.column(name).to_numpy(zero_copy_only=False).astype(np.float64) for name in names])

    count = len(table)
    covariance = np.zeros((count, 3, 3))
    sigmas = np.nan_to_num(read("sigma_east_m", "sigma_north_m", "sigma_up_m"))
    for row, values in enumerate(table.column("covariance_site").to_pylist()):
        covariance[row] = np.diag(sigmas[row] ** 2) if values is None else np.reshape(values, (3, 3))
    classes = table.column("defect_class").to_pylist()
    return DefectArrays(
        defect_id=np.array(table.column("defect_id").to_pylist(), dtype=object),
        defect_class=np.array([CLASSES.index(name) for name in classes], dtype=np.int64),
        facade=np.array([name or "" for name in table.column("facade").to_pylist()], dtype=object),
        xyz_site_m=read("x_site_m", "y_site_m", "z_site_m"),
        covariance_m2=covariance,
        normal_site=read("normal_x", "normal_y", "normal_z"),
        width_m=read("width_m")[:, 0],
        height_m=read("height_m")[:, 0],
    )
