"""The coordinate operation from the CRS of the control to that of the model, and the error it adds to all control."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.geodesy import compute_operation_sigma, find_operation, transform
from facadelake.core.proj.crs import AREA_MARGIN_DEG, ECEF, GEO, combine_crs, is_in_area_of_use
from facadelake.core.proj.operations import PlacedOperation, require_best
from facadelake.georeferencing.site_frame import SiteFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class DatumShift:
    """The operation from the CRS of the control to that of the model.

    ``sigma_m`` (3,: east, north, up): one sigma that it adds to every control point alike; zero in one datum.
    ``convention_m``: stated accuracy of a null transformation (WGS 84 taken as ETRS89), which is not in ``sigma_m``
    unless ``include_convention`` has put it there.
    """

    operation: PlacedOperation
    sigma_m: Float64x3
    convention_m: float = 0.0

    @property
    def covariance_m2(self) -> Float64x3x3:
        """Covariance (3, 3) of the common shift."""
        return np.diag(self.sigma_m**2)

    def include_convention(self) -> DatumShift:
        """The shift of positions that a receiver observed, for which a null transformation is no convention."""
        return replace(self, sigma_m=np.hypot(self.sigma_m, self.convention_m))

    def describe(self) -> str:
        """The operation with its CRSs and accuracy in words."""
        return f"from {self.operation.source} to {self.operation.target} by {self.operation.describe()}"


def name_model_crs(site_frame: SiteFrame) -> str:
    """The CRS of the model's map coordinates with its heights."""
    return combine_crs(site_frame.map_crs, site_frame.vertical_datum)


def find_model_operation(site_frame: SiteFrame) -> PlacedOperation:
    """The operation from the model's CRS to EPSG:4979, in which longitudes and latitudes are published."""
    origin = site_frame.origin
    return find_operation(name_model_crs(site_frame), GEO, lon_deg=origin.lon_deg, lat_deg=origin.lat_deg)


def find_datum_shift(crs: str, site_frame: SiteFrame) -> DatumShift:
    """The shift of control in ``crs``, a CRS with heights.

    Raises GeoreferenceError where PROJ has no operation, or lacks the grid of the best and the portfolio does not
    accept the next.
    """
    place = {"lon_deg": site_frame.origin.lon_deg, "lat_deg": site_frame.origin.lat_deg}
    model_crs = name_model_crs(site_frame)
    operation = find_operation(crs, model_crs, **place)
    require_best(operation, site_frame.accepted_operation_accuracy_m)
    added = compute_operation_sigma(crs, model_crs, **place)
    return DatumShift(operation=operation, sigma_m=added.sigma_m, convention_m=added.convention_m)


def build_operation_columns(site_frame: SiteFrame, shift: DatumShift | None) -> dict[str, Any]:
    """Columns of table ``georeference``: the operation of the published longitudes, and that of the control."""
    published = find_model_operation(site_frame)
    columns: dict[str, Any] = {"crs_operation": published.name, "crs_operation_accuracy_m": published.accuracy_m}
    if shift is not None:
        columns |= {
            "control_operation": shift.operation.name,
            "control_operation_accuracy_m": shift.operation.accuracy_m,
            "control_operation_sigma_m": float(shift.sigma_m.max()),
        }
    return columns


def describe_datum_shift(shift: DatumShift | None, sigma_m: Float64x3) -> str:
    """Remark where the shift between datums is larger than all other errors of a campaign's position; else empty.

    ``sigma_m`` (3,): one sigma of the position, with that of the shift.
    """
    if shift is not None and shift.convention_m > sigma_m.max():
        return (
            f"positions in {shift.operation.source} are taken as {shift.operation.target} without a shift "
            f"({shift.operation.name}, accuracy {shift.convention_m:g} m, not in the sigmas): right if they were "
            "computed from it or corrected by its service, else name the CRS that they were observed in"
        )
    if shift is None or not (shift.sigma_m**2 > 0.5 * sigma_m**2).any():
        return ""
    remedy = (
        "where a service corrected the positions, name its datum with crs.gnss in the portfolio"
        if shift.convention_m
        else "control in the CRS of the model has none"
    )
    return (
        f"the position's sigma of {sigma_m.max():.2g} m is mostly that of the transformation {shift.describe()}; "
        f"{remedy}"
    )


def site_from_crs(xyz: Float64Nx3, crs: str, site_frame: SiteFrame) -> Float64Nx3:
    """Points (n, 3) of ``crs``, a CRS with heights, in site; via the model's CRS, which defines the site frame."""
    geo = transform(xyz, crs, GEO)
    model_crs = name_model_crs(site_frame)
    # Control in another country is told by its distance from the building, by those who know what it is for.
    if crs not in (GEO, ECEF) and _lies_in_area(geo, model_crs):
        geo = transform(transform(xyz, crs, model_crs), model_crs, GEO)
    return site_frame.origin.site_from_geo(geo)


def _lies_in_area(geo: Float64Nx3, crs: str) -> bool:
    return all(is_in_area_of_use(crs, lon, lat, AREA_MARGIN_DEG) for lon, lat, _ in geo.tolist())
