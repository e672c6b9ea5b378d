"""The reference of a building: tie points of a placed campaign, by which later campaigns find into its frame."""

from __future__ import annotations

import hashlib
import json
import shutil
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import Float64Array, Int64Array, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.sfm import Reconstruction, describe_tie_point_views

MAX_POINTS = 100_000
# A point that is known no better than this says nothing of a campaign to be placed at the centimetre.
MAX_SIGMA_M = 0.10
_VOXEL_M = 0.5
_MIN_PHOTOGRAPHS = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePoints:
    """Tie points of a placed campaign, in site about ``origin``.

    ``xyz_site_m`` (n, 3); ``covariance_m2`` (n, 3, 3), each point's own error **within the campaign's block**;
    ``descriptors`` (n, 128) SIFT; ``direction_site`` (n, 3) unit, the mean direction in which the photographs looked at
    the point; ``gsd_m`` (n,) metres a pixel where it was seen best; ``photographs`` (n,) that saw it.

    ``frame_covariance_m2`` (3, 3) is what all points have in common: how well the campaign itself was placed. A later
    campaign that is adjusted to these points stands to the *reference* as well as the points' own covariances say, and
    to the *globe* no better than ``frame_covariance_m2``: the common error moves all points together, so it must not
    enter the adjustment point by point (it would be averaged away), but is added to the poses' covariances afterwards.
    """

    building_id: str
    campaign_id: str
    origin: SiteOrigin
    xyz_site_m: Float64Array
    covariance_m2: Float64Array
    descriptors: UInt8Array
    direction_site: Float64Array
    gsd_m: Float64Array
    photographs: Int64Array
    frame_covariance_m2: Float64Array

    def __len__(self) -> int:
        return len(self.xyz_site_m)

    def transform_to(self, origin: SiteOrigin) -> ReferencePoints:
        """The same points on the globe in the site frame about another ``origin`` (a model that was exported anew)."""
        if origin == self.origin:
            return self
        move = origin.ecef_from_site().invert() @ self.origin.ecef_from_site()
        turn = move.rotation
        return ReferencePoints(
            **{
                **vars(self),
                "origin": origin,
                "xyz_site_m": move.apply(self.xyz_site_m),
                "covariance_m2": turn @ self.covariance_m2 @ turn.T,
                "direction_site": move.rotate(self.direction_site),
                "frame_covariance_m2": turn @ self.frame_covariance_m2 @ turn.T,
            }
        )

    def save(self, path: Path) -> str:
        """Write one file, for ``read_reference``; returns the hash of its content, which the file carries too."""
        said, arrays = self._parts()
        digest = _content_hash(said, arrays)
        with path.open("wb") as stream:
            np.savez(stream, said=np.array(json.dumps(said | {"content_hash": digest}, sort_keys=True)), **arrays)
        return digest

    def _parts(self) -> tuple[dict[str, object], dict[str, Any]]:
        said: dict[str, object] = {
            "building_id": self.building_id,
            "campaign_id": self.campaign_id,
            "origin": vars(self.origin),
        }
        names = ("xyz_site_m", "covariance_m2", "descriptors", "direction_site", "gsd_m", "photographs")
        return said, {name: getattr(self, name) for name in (*names, "frame_covariance_m2")}


def _content_hash(said: Mapping[str, object], arrays: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def read_reference(path: Path) -> ReferencePoints:
    """The reference that ``save`` wrote; raises InputDataError where it is missing, cut short or changed."""
    try:
        with np.load(path) as loaded:
            arrays = dict(loaded)
        said = json.loads(str(arrays.pop("said")))
        digest = said.pop("content_hash")
        origin = SiteOrigin(**said["origin"])
        reference = ReferencePoints(
            building_id=said["building_id"], campaign_id=said["campaign_id"], origin=origin, **arrays
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputDataError(
            f"{path} holds no whole reference ({error}); georeference the earlier campaign again, or place this one "
            "without a reference"
        ) from error
    if _content_hash(said, arrays) != digest:
        raise InputDataError(
            f"{path} was changed after it was written (its content does not match its hash {digest[:12]}); "
            "georeference the earlier campaign again"
        )
    return reference


def build_reference(
    reconstruction: Reconstruction,
    descriptors: UInt8Array,
    *,
    cameras: Sequence[PosedCamera],
    xyz_site_m: Float64Array,
    covariance_m2: Float64Array,
    frame_covariance_m2: Float64Array,
    building_id: str,
    campaign_id: str,
    origin: SiteOrigin,
    most: int = MAX_POINTS,
) -> ReferencePoints:
    """The reference that a placed campaign leaves: its ``most`` best tie points, spread over the building.

    ``descriptors`` (m, 128), ``xyz_site_m`` (m, 3) and ``covariance_m2`` (m, 3, 3) follow ``reconstruction.xyz_sfm``;
    NaN where the adjustment dropped a point. ``cameras``: the adjusted ones, in the order of ``reconstruction.photos``.
    Raises GeoreferenceError where no point is known to better than 10 cm.
    """
    check_descriptor_count(reconstruction, descriptors)
    sigma_m = _compute_largest_sigma(covariance_m2)
    seen = describe_tie_point_views(reconstruction, cameras, xyz_site_m)
    usable = np.isfinite(xyz_site_m).all(axis=1) & (seen.photographs >= _MIN_PHOTOGRAPHS) & (sigma_m <= MAX_SIGMA_M)
    if not usable.any():
        raise GeoreferenceError(
            f"none of the {len(xyz_site_m)} tie points is known to {MAX_SIGMA_M:.2f} m, so this campaign cannot be "
            "the reference of later ones; photograph with more overlap, or nearer"
        )
    # Long tracks are found again more surely than short ones; of two as long the better known one.
    worth = np.sqrt(seen.photographs) / np.maximum(sigma_m, 1e-4)
    kept = np.flatnonzero(usable)
    kept = kept[choose_spread_points(xyz_site_m[kept], worth[kept], most=most)]
    return ReferencePoints(
        building_id=building_id,
        campaign_id=campaign_id,
        origin=origin,
        xyz_site_m=xyz_site_m[kept],
        covariance_m2=covariance_m2[kept],
        descriptors=descriptors[kept],
        direction_site=seen.direction[kept],
        gsd_m=seen.gsd[kept],
        photographs=seen.photographs[kept],
        frame_covariance_m2=frame_covariance_m2,
    )


def check_descriptor_count(reconstruction: Reconstruction, descriptors: UInt8Array) -> None:
    """Raise InputDataError where the descriptors are not those of the reconstruction's tie points, row by row."""
    if descriptors.shape != (len(reconstruction.xyz_sfm), 128):
        raise InputDataError(
            f"the descriptors are {descriptors.shape} for {len(reconstruction.xyz_sfm)} tie points (128 numbers for "
            "each are needed): they belong to another reconstruction; remove its folder and run again"
        )


def choose_spread_points(xyz_m: Float64Array, worth: Float64Array, *, most: int) -> Int64Array:
    """Rows (sorted) of the ``most`` points: each half-metre cell gives its worthiest, then its second, and so on."""
    if len(xyz_m) <= most:
        return np.arange(len(xyz_m))
    cell = np.unique(np.floor(xyz_m / _VOXEL_M).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((-worth, cell))
    first_of_cell = np.r_[0, np.flatnonzero(np.diff(cell[order])) + 1]
    rank = np.arange(len(order)) - np.repeat(first_of_cell, np.diff(np.r_[first_of_cell, len(order)]))
    chosen: Int64Array = np.sort(order[np.lexsort((-worth[order], rank))[:most]])
    return chosen


def _compute_largest_sigma(covariance_m2: Float64Array) -> Float64Array:
    """One sigma (m,) in the direction in which each point is known worst; inf where it is not known."""
    whole = np.isfinite(covariance_m2).all(axis=(1, 2))
    sigma = np.full(len(covariance_m2), np.inf)
    values = np.linalg.eigvalsh(covariance_m2[whole])
    sigma[whole] = np.where(values[:, 0] > 0, np.sqrt(np.maximum(values[:, 2], 0)), np.inf)
    return sigma


REFERENCE_FILE = "reference.npz"


def _get_folder(lake: Path, building_id: str) -> Path:
    return lake / "references" / building_id


def list_earlier_references(lake: Path, building_id: str, campaign_id: str) -> list[Path]:
    """References of the building's campaigns whose id sorts before ``campaign_id``, the first campaign first."""
    folder = _get_folder(lake, building_id)
    return sorted(path for path in folder.glob("*.npz") if path.stem < campaign_id)


def store_reference(made: Path, lake: Path, building_id: str, campaign_id: str) -> Path:
    """Keep the reference of a committed campaign in the lake's folder; an older one of the same campaign is replaced
    whole."""
    folder = _get_folder(lake, building_id)
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f".{campaign_id}.{uuid.uuid4().hex[:8]}.part"
    try:
        shutil.copyfile(made, part)
        kept = folder / f"{campaign_id}.npz"
        part.replace(kept)
    finally:
        part.unlink(missing_ok=True)
    return kept


def drop_reference(lake: Path, building_id: str, campaign_id: str) -> None:
    """Forget the reference of a campaign that was committed anew without one: its frame is no longer that one."""
    (_get_folder(lake, building_id) / f"{campaign_id}.npz").unlink(missing_ok=True)
