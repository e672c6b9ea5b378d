"""The reference of a campaign: tie points by which later campaigns are placed in its frame; one file a campaign."""

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

from facadelake.core.arrays import Float64N, Float64Nx3, Float64Nx3x3, Float64x3x3, Int64Array, UInt8Array
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.sfm import Reconstruction

REFERENCE_FILE = "reference.npz"
MAX_POINTS = 100_000


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePoints:
    """Tie points of a placed campaign, in site about ``origin``.

    ``xyz_site_m`` (n, 3); ``covariance_m2`` (n, 3, 3), each point's own error **within the campaign's block**;
    ``descriptors`` (n, 128) SIFT; ``direction_site`` (n, 3): unit mean viewing direction of the photographs that show
    the point; ``gsd_m`` (n,): smallest ground sampling distance; ``photographs`` (n,): number that show it.

    ``frame_covariance_m2`` (3, 3): error that all points share, the accuracy of the campaign's own placement. A later
    campaign adjusted to these points is known relative to the *reference* as their own covariances state, and on the
    *globe* no better than ``frame_covariance_m2``. The common error moves all points together, so it must not enter the
    adjustment point by point (it would be averaged away); it is added to the poses' covariances afterwards.
    """

    building_id: str
    campaign_id: str
    origin: SiteOrigin
    xyz_site_m: Float64Nx3
    covariance_m2: Float64Nx3x3
    descriptors: UInt8Array
    direction_site: Float64Nx3
    gsd_m: Float64N
    photographs: Int64Array
    frame_covariance_m2: Float64x3x3

    def __len__(self) -> int:
        return len(self.xyz_site_m)

    def transform_to(self, origin: SiteOrigin) -> ReferencePoints:
        """The same points in the site frame about another ``origin`` (of a model exported again)."""
        if origin == self.origin:
            return self
        new_from_old = origin.ecef_from_site().invert() @ self.origin.ecef_from_site()
        rotation = new_from_old.rotation
        return ReferencePoints(
            **{
                **vars(self),
                "origin": origin,
                "xyz_site_m": new_from_old.apply(self.xyz_site_m),
                "covariance_m2": rotation @ self.covariance_m2 @ rotation.T,
                "direction_site": new_from_old.rotate(self.direction_site),
                "frame_covariance_m2": rotation @ self.frame_covariance_m2 @ rotation.T,
            }
        )

    def save(self, path: Path) -> str:
        """Write one file, for ``read_reference``; returns the hash of its content, which the file contains too.

        The header is the file's entry ``said``.
        """
        header, arrays = self._split_content()
        digest = _hash_content(header, arrays)
        stored = np.array(json.dumps(header | {"content_hash": digest}, sort_keys=True))
        with path.open("wb") as stream:
            np.savez(stream, said=stored, **arrays)
        return digest

    def _split_content(self) -> tuple[dict[str, object], dict[str, Any]]:
        header: dict[str, object] = {
            "building_id": self.building_id,
            "campaign_id": self.campaign_id,
            "origin": vars(self.origin),
        }
        names = ("xyz_site_m", "covariance_m2", "descriptors", "direction_site", "gsd_m", "photographs")
        return header, {name: getattr(self, name) for name in (*names, "frame_covariance_m2")}


def _hash_content(header: Mapping[str, object], arrays: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def read_reference(path: Path) -> ReferencePoints:
    """Read a file that ``save`` wrote; raises InputDataError where it is missing, truncated or changed."""
    try:
        with np.load(path) as loaded:
            arrays = dict(loaded)
        header = json.loads(str(arrays.pop("said")))
        digest = header.pop("content_hash")
        origin = SiteOrigin(**header["origin"])
        reference = ReferencePoints(
            building_id=header["building_id"], campaign_id=header["campaign_id"], origin=origin, **arrays
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputDataError(
            f"{path} is not a complete reference file ({error}); georeference the earlier campaign again, or place "
            "this one without a reference"
        ) from error
    if _hash_content(header, arrays) != digest:
        raise InputDataError(
            f"{path} was changed after it was written (its content does not match its hash {digest[:12]}); "
            "georeference the earlier campaign again"
        )
    return reference


def check_descriptor_count(reconstruction: Reconstruction, descriptors: UInt8Array) -> None:
    """Raise InputDataError where the descriptors are not one for each of the reconstruction's tie points."""
    if descriptors.shape != (len(reconstruction.xyz_sfm), 128):
        raise InputDataError(
            f"the descriptors are an array of {descriptors.shape} for {len(reconstruction.xyz_sfm)} tie points (128 "
            "numbers for each are needed): they belong to another reconstruction; remove its folder and run again"
        )


def _get_folder(lake: Path, building_id: str) -> Path:
    return lake / "references" / building_id


def list_references(lake: Path, building_id: str, campaigns: Sequence[str]) -> list[Path]:
    """Reference files of those campaigns of the building that have one, in the given order."""
    files = (_get_folder(lake, building_id) / f"{campaign_id}.npz" for campaign_id in campaigns)
    return [path for path in files if path.is_file()]


def store_reference(source: Path, lake: Path, building_id: str, campaign_id: str) -> Path:
    """Store the reference file of a committed campaign in the lake.

    Args:
        source: the reference file that the campaign wrote.
        lake: the lake's folder.
        building_id: the building.
        campaign_id: the campaign; its older reference is replaced atomically.

    Returns:
        the stored file.
    """
    folder = _get_folder(lake, building_id)
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f".{campaign_id}.{uuid.uuid4().hex[:8]}.part"
    try:
        shutil.copyfile(source, part)
        stored = folder / f"{campaign_id}.npz"
        part.replace(stored)
    finally:
        part.unlink(missing_ok=True)
    return stored


def drop_reference(lake: Path, building_id: str, campaign_id: str) -> None:
    """Remove the reference of a campaign that was committed again without one: its old frame is no longer valid."""
    (_get_folder(lake, building_id) / f"{campaign_id}.npz").unlink(missing_ok=True)
