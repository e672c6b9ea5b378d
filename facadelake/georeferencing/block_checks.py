"""The placement checks of an adjusted block: GPS, surveyed points and the model against its placement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.core.arrays import Float64x3
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.point_to_plane import select_points_with_origins
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.initial_placement import CONTROL_SIGMA_M
from facadelake.georeferencing.model_checks import check_cameras, check_tie_points
from facadelake.georeferencing.passport import PassportPoint
from facadelake.georeferencing.placement_checks import PlacementCheck, check_gps, check_surveyed_points
from schemas.vocabulary import PlacementStatement, PointKind


def check_block(
    priors: GpsPriors, adjusted: AdjustedBlock, sigma_m: Float64x3, points: Sequence[PassportPoint], control: Control
) -> tuple[PlacementCheck, ...]:
    """Compare the adjusted block with GPS, surveyed points and the model.

    Args:
        priors: the GPS priors.
        adjusted: the adjusted block.
        sigma_m: one sigma (3,) of the campaign's position.
        points: the passport's points, of which held-out and check points are compared.
        control: the control available, for its model.

    Returns:
        the checks; those by the model where there is one.
    """
    residual_m = priors.xyz_site_m - np.array([camera.centre_site_m for camera in adjusted.cameras])[priors.photo]
    gps_sigma_m = priors.sigma_m
    if priors.datum_shift is not None:
        gps_sigma_m = np.hypot(gps_sigma_m, priors.datum_shift.sigma_m)
    gps = check_gps(
        residual_m, gps_sigma_m, priors.flight, sigma_m, priors.convention_m, datum_unknown=priors.datum_unknown
    )
    checks = [
        *gps,
        *(
            check_surveyed_points(
                statement,
                np.array([np.linalg.norm(point.residual_site_m) for point in points if point.kind is kind]),
                sigma_m,
                CONTROL_SIGMA_M,
            )
            for statement, kind in (
                (PlacementStatement.HELD_OUT_POINTS, PointKind.HELD_OUT),
                (PlacementStatement.SURVEYED_POINTS, PointKind.CHECK),
            )
        ),
    ]
    model = control.model
    if model is not None:
        surface = model.building_surface or model.surface
        checks += check_cameras(adjusted.cameras, surface, model.ground_site_m, model.highest_site_m)
        state = adjusted.solution.state
        point, origin_site_m = select_points_with_origins(adjusted.tie_points, state)
        checks.append(
            check_tie_points(
                state.xyz_site_m[point],
                origin_site_m,
                surface,
                gps_shift_site_m=np.median(residual_m, axis=0) if len(residual_m) else np.zeros(3),
                sigma_m=np.hypot(sigma_m, model.sigma_m),
            )
        )
    return tuple(checks)
