"""The frame ``facade``: the vertical plane of a facade, in metres from the site's origin.

``u`` points to the right as seen from outside, ``v`` up, ``w`` outward. GIS layers, elevations and cards have the same
``u`` and ``v``, which follow from a position in ``site`` and column ``facade_azimuth_deg`` of table ``defects``.
"""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import Float64Nx3, Float64x3, Float64x3x3

COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


def compute_facade_axes(azimuth_deg: float) -> Float64x3x3:
    """Unit vectors u, v, w in site as rows, of a facade with outward azimuth ``azimuth_deg``, clockwise from north."""
    azimuth = np.radians(azimuth_deg)
    return np.array([[-np.cos(azimuth), np.sin(azimuth), 0.0], [0, 0, 1], [np.sin(azimuth), np.cos(azimuth), 0.0]])


def facade_from_site(xyz_site_m: Float64Nx3, azimuth_deg: float) -> Float64Nx3:
    """Coordinates u, v, w (n, 3) in metres of points (n, 3) of site."""
    uvw: Float64Nx3 = np.asarray(xyz_site_m, dtype=np.float64) @ compute_facade_axes(azimuth_deg).T
    return uvw


def axes_from_normal(normal_site: Float64x3) -> Float64x3x3:
    """Unit vectors right, up and outward (rows) of a surface with outward ``normal_site``, as seen from outside.

    Right of a horizontal surface is east.
    """
    out = normal_site / np.linalg.norm(normal_site)
    right = np.cross([0.0, 0.0, 1.0], out)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(out, right), out])
