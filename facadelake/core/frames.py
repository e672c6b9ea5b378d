"""Frames and the transforms between them.

The frames, a closed list: ``img`` (pixels), ``cam`` (x right, y down, z forward), ``sfm`` (no scale), ``site``
(local east-north-up metres at the building's origin), ``facade`` (a facade's vertical plane: u to the right as seen
from outside, v up, w outward; metres from the origin of ``site``), ``ifc`` (the model's own), ``ecef`` (EPSG:4978),
``geo`` (EPSG:4979: lon, lat, ellipsoidal height), ``map`` (the projected CRS of the model).

A transform is named ``target_from_source``; chains are checked by reading: ``site_from_cam = site_from_sfm @
sfm_from_cam``.
The centre of the top left pixel is (0.5, 0.5), as in COLMAP.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.errors import GeoreferenceError

COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


@dataclass(frozen=True, kw_only=True, eq=False)
class Similarity:
    """A similarity ``x_target = scale * rotation @ x_source + translation``.

    ``rotation`` (3, 3) is proper orthonormal, ``translation`` (3,) in the target's units, ``scale`` > 0 (1: rigid).
    """

    rotation: Float64x3x3
    translation: Float64x3
    scale: float = 1.0

    def __post_init__(self) -> None:
        orthonormal = np.allclose(self.rotation @ self.rotation.T, np.eye(3), rtol=0, atol=1e-6)
        if self.rotation.shape != (3, 3) or not orthonormal or np.linalg.det(self.rotation) < 0:
            raise GeoreferenceError(
                "the rotation of a transform is not a proper rotation; "
                "it must be an orthonormal 3x3 matrix of determinant +1"
            )
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise GeoreferenceError(f"the scale of a transform is {self.scale}; it must be a positive number")

    @staticmethod
    def make_identity() -> Similarity:
        """The transform from a frame to itself."""
        return Similarity(rotation=np.eye(3), translation=np.zeros(3))

    def __matmul__(self, other: Similarity) -> Similarity:
        """The composition: ``(a_from_b @ b_from_c)`` is ``a_from_c``."""
        return Similarity(
            rotation=self.rotation @ other.rotation,
            translation=self.scale * (self.rotation @ other.translation) + self.translation,
            scale=self.scale * other.scale,
        )

    def invert(self) -> Similarity:
        """The inverse transform: ``source_from_target``."""
        rotation = self.rotation.T
        return Similarity(
            rotation=rotation, translation=-(rotation @ self.translation) / self.scale, scale=1.0 / self.scale
        )

    def apply(self, xyz_source: Float64Array) -> Float64Array:
        """Points (..., 3) of the source frame in the target frame."""
        return self.scale * (np.asarray(xyz_source, dtype=np.float64) @ self.rotation.T) + self.translation

    def save(self, path: Path) -> None:
        """Write the transform as JSON, for ``read_similarity``."""
        values = {"rotation": self.rotation.tolist(), "translation": self.translation.tolist(), "scale": self.scale}
        path.write_text(json.dumps(values))

    def rotate(self, direction_source: Float64Array) -> Float64Array:
        """Directions (..., 3) of the source frame in the target frame: rotated, neither translated nor scaled."""
        return np.asarray(direction_source, dtype=np.float64) @ self.rotation.T


def read_similarity(path: Path) -> Similarity:
    """Read a transform that ``Similarity.save`` wrote."""
    values = json.loads(path.read_text())
    return Similarity(
        rotation=np.array(values["rotation"]), translation=np.array(values["translation"]), scale=values["scale"]
    )


def estimate_similarity(xyz_source: Float64Nx3, xyz_target: Float64Nx3, weights: Float64N | None = None) -> Similarity:
    """Weighted least-squares similarity from ``xyz_source`` (n, 3) to ``xyz_target`` (n, 3), by Umeyama's method.

    ``weights`` (n,) are relative; None: equal weights. Raises GeoreferenceError for fewer than 3 points, and for points
    on one line, which leave a rotation undetermined.
    Source: Umeyama 1991, IEEE PAMI 13(4).
    """
    if len(xyz_source) != len(xyz_target) or len(xyz_source) < 3:
        raise GeoreferenceError(
            f"a similarity needs 3 or more point pairs, {len(xyz_source)} were given; "
            "add control points or photographs with GPS"
        )
    w = np.ones(len(xyz_source)) if weights is None else np.asarray(weights, dtype=np.float64)
    w = w / w.sum()
    mean_source, mean_target = w @ xyz_source, w @ xyz_target
    source, target = xyz_source - mean_source, xyz_target - mean_target
    spread = np.linalg.svd(source * np.sqrt(w)[:, None], compute_uv=False)
    if spread[1] < 1e-6 * max(spread[0], 1e-300):
        raise GeoreferenceError(
            "the points lie on one line, so that the rotation about it is undetermined; add points off that line"
        )
    u, s, vt = np.linalg.svd((target * w[:, None]).T @ source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u @ np.diag(signs) @ vt
    scale = float((s * signs).sum() / (w @ (source**2).sum(axis=1)))
    return Similarity(rotation=rotation, translation=mean_target - scale * rotation @ mean_source, scale=scale)


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
