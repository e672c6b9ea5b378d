"""Accuracy with which a later campaign is placed in the frame of an earlier one by shared tie points alone.

    .venv/bin/python -m benchmarks.frames demo castle [--work FOLDER]

The campaigns are two of the demo (half a year apart, other light, other defects), and the castle's photographs
divided into those of even and odd number. The earlier campaign is placed by truth, so that only the step between the
frames is measured; then the later one is matched. *Camera error*: the later cameras against truth, after the similarity
alone. *Step between frames*: check points triangulated from the box centres of each campaign, later minus earlier, less
their true movement; a comparison of defects contains the same step. A building that is matched with the reference of
the other one must be refused. ``--work`` keeps the reconstructions (about 10 minutes on 2 cores) for another run.
Prints Markdown.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.detection.coco import read_coco
from facadelake.evaluation.campaigns.truth import Truth, read_truth
from facadelake.georeferencing.campaign.matching import ReferenceMatch, match_reference
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.campaign.reference_selection import build_reference
from facadelake.georeferencing.similarity_fit import fit_similarity
from facadelake.georeferencing.triangulation import ImageRay, intersect_rays
from facadelake.photos import ingest_photographs
from facadelake.sfm import (
    Reconstruction,
    ReconstructionSettings,
    compute_tie_point_covariance,
    estimate_pixel_sigma,
    read_descriptors,
    read_reconstruction,
    reconstruct,
)

ROOT = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("FACADELAKE_SHARED_DATA", ROOT.parent / "shared" / "data"))
DEMO = Path(os.environ.get("FACADELAKE_DEMO", ROOT / "build" / "demo"))
# Published cameras against a free block of few photographs: larger differences are errors of the block's weak ends.
_CAMERA_SIGMA_M = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class ReconstructedCampaign:
    """A reconstructed campaign, its truth, and the centres of its boxes by check point: photograph and pixel (2,)."""

    name: str
    campaign: Path
    folder: Path
    reconstruction: Reconstruction
    truth: Truth
    origin: SiteOrigin
    boxes: Mapping[str, Sequence[tuple[str, Float64Array]]]

    @property
    def centres_site_m(self) -> Float64Array:
        """Published camera centres (n, 3) of the photographs, site, metres."""
        geo = np.array([self.truth.cameras[photo.photo_id] for photo in self.reconstruction.photos])
        return self.origin.site_from_geo(geo)

    def locate_check_point(self, name: str) -> Float64Array:
        """Published position (3,) of a check point, site, metres."""
        position: Float64Array = self.origin.site_from_geo(self.truth.checkpoints[name].geo[None])[0]
        return position

    def place_photographs(self, site_from_sfm: Similarity) -> list[PosedCamera]:
        """Cameras of the photographs in site."""
        return [
            PosedCamera(
                camera=photo.camera,
                site_from_cam=Similarity(
                    rotation=site_from_sfm.rotation @ photo.sfm_from_cam.rotation,
                    translation=site_from_sfm.apply(photo.sfm_from_cam.translation),
                ),
            )
            for photo in self.reconstruction.photos
        ]


def reconstruct_campaign(
    name: str, campaign: Path, origin: SiteOrigin, work: Path, *, every_other: int | None = None
) -> ReconstructedCampaign:
    """Reconstruct a campaign, or read its reconstruction from ``work``.

    Args:
        name: name of the campaign, and of its folder in ``work``.
        campaign: folder with images, detections and truth.
        origin: origin of the site frame.
        work: folder of the reconstructions.
        every_other: number (0 or 1) of the first photograph, if only every second one of each role is used.
    """
    folder = work / name
    photos = ingest_photographs(campaign / "images", distance_to_model_m=None, close_range_below_m=10.0)
    if not (folder / "descriptors.npy").is_file():
        if every_other is not None:
            roles = np.array(photos.column("role").to_pylist())
            numbers = [np.flatnonzero(roles == role)[every_other::2] for role in np.unique(roles)]
            photos = photos.take(pa.array(np.sort(np.concatenate(numbers))))
        begin = time.perf_counter()
        folder.mkdir(parents=True)
        reconstruct(photos, campaign / "images", folder, ReconstructionSettings())
        print(f"{name}: reconstructed in {time.perf_counter() - begin:.0f} s", flush=True)
    found = read_reconstruction(folder)
    truth = read_truth(campaign / "truth")
    return ReconstructedCampaign(
        name=name,
        campaign=campaign,
        folder=folder,
        reconstruction=found,
        truth=truth,
        origin=origin,
        boxes=_list_box_centres(campaign, truth, {photo.photo_id for photo in found.photos}),
    )


def _list_box_centres(campaign: Path, truth: Truth, localised: set[str]) -> dict[str, list[tuple[str, Float64Array]]]:
    coco = read_coco(campaign / "detections.coco.json")
    centres: dict[str, list[tuple[str, Float64Array]]] = defaultdict(list)
    for annotation in coco.annotations:
        point = truth.check_point_of_annotation[coco.path.name, annotation.annotation_id]
        photo_id = coco.images[annotation.image_id].file_name
        if point is not None and photo_id in localised:
            x, y, width, height = annotation.bbox
            centres[point].append((photo_id, np.array([x + width / 2, y + height / 2])))
    return centres


def build_campaign_reference(earlier: ReconstructedCampaign) -> tuple[ReferencePoints, Similarity]:
    """Place a campaign by truth; its reference, and the similarity site_from_sfm."""
    sfm = earlier.reconstruction
    sigma = np.full((len(sfm.photos), 3), _CAMERA_SIGMA_M)
    site_from_sfm = fit_similarity(sfm.centres_sfm, earlier.centres_site_m, sigma).target_from_source
    cameras, xyz_site_m = earlier.place_photographs(site_from_sfm), site_from_sfm.apply(sfm.xyz_sfm)
    points = build_reference(
        sfm,
        read_descriptors(earlier.folder),
        cameras=cameras,
        xyz_site_m=xyz_site_m,
        covariance_m2=compute_tie_point_covariance(sfm, cameras, xyz_site_m, sigma_px=estimate_pixel_sigma(sfm)),
        frame_covariance_m2=np.zeros((3, 3)),
        building_id=earlier.name.split()[0],
        campaign_id=earlier.name,
        origin=earlier.origin,
    )
    return points, site_from_sfm


def triangulate_check_points(campaign: ReconstructedCampaign, site_from_sfm: Similarity) -> dict[str, Float64Array]:
    """Check points (3,) in site, triangulated from the box centres of one campaign."""
    posed = dict(
        zip(
            (p.photo_id for p in campaign.reconstruction.photos), campaign.place_photographs(site_from_sfm), strict=True
        )
    )
    found = {}
    for name, marks in campaign.boxes.items():
        views = [ImageRay(camera=posed[p].camera, world_from_cam=posed[p].site_from_cam, xy_img=xy) for p, xy in marks]
        point = intersect_rays(views) if len(views) >= 2 else None
        if point is not None:
            found[name] = point.xyz_world
    return found


def format_row(earlier: ReconstructedCampaign, later: ReconstructedCampaign) -> str:
    """Match the later campaign with the earlier one's reference; one row of the table."""
    points, site_from_earlier = build_campaign_reference(earlier)
    begin = time.perf_counter()
    match = match_reference(later.reconstruction, read_descriptors(later.folder), points, origin=later.origin)
    seconds = time.perf_counter() - begin
    camera_m = np.linalg.norm(
        match.site_from_sfm.apply(later.reconstruction.centres_sfm) - later.centres_site_m, axis=1
    )
    own_m = np.linalg.norm(site_from_earlier.apply(earlier.reconstruction.centres_sfm) - earlier.centres_site_m, axis=1)
    before, after = (
        triangulate_check_points(earlier, site_from_earlier),
        triangulate_check_points(later, match.site_from_sfm),
    )
    both = sorted(before.keys() & after.keys())
    step_m = np.array(
        [
            np.linalg.norm((after[p] - before[p]) - (later.locate_check_point(p) - earlier.locate_check_point(p)))
            for p in both
        ]
    )
    cells = [
        f"{later.name} in {earlier.name}",
        f"{match.points_compared} / {match.reference_points}",
        f"{match.pairs}",
        f"{match.agreeing} ({match.agreeing / match.pairs:.0%})",
        f"{len(match.point)}",
        f"{match.runner_up}",
        f"{np.median(own_m) * 100:.1f} / {own_m.max() * 100:.1f}",
        f"{camera_m.mean() * 100:.1f} / {np.median(camera_m) * 100:.1f} / {camera_m.max() * 100:.1f}",
        f"{len(both)}: {step_m.mean() * 100:.2f} / {np.median(step_m) * 100:.2f} / {step_m.max() * 100:.2f}",
        f"{_compute_share_within(match):.2f}",
        f"{seconds:.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def _compute_share_within(match: ReferenceMatch) -> float:
    """Share of the residuals inside the 95 % ellipsoid of the prior's covariance (chi-square with 3 degrees: 7.81)."""
    squared = np.einsum("ki,kij,kj->k", match.residual_m, np.linalg.inv(match.covariance_m2), match.residual_m)
    return float((squared < 7.81).mean())


HEADER = (
    "| match | tie points later / reference | pairs | agreeing | used | runner-up | earlier cameras median / max cm | "
    "later cameras mean / median / max cm | step between frames: points: mean / median / max cm | residuals within "
    "95 % | s |\n|" + "---|" * 11
)


def check_refusal(earlier: ReconstructedCampaign, later: ReconstructedCampaign) -> str:
    """Match a building with the reference of another one, which must be refused; a line with the outcome."""
    try:
        match = match_reference(
            later.reconstruction,
            read_descriptors(later.folder),
            build_campaign_reference(earlier)[0],
            origin=later.origin,
        )
    except GeoreferenceError as error:
        return f"{later.name} in {earlier.name}, another building: refused: {error}"
    return f"{later.name} in {earlier.name}, ANOTHER BUILDING: ACCEPTED, {len(match.point)} points"


def main() -> None:
    """Measure the buildings on the command line; with both, also match each with the other's reference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("buildings", nargs="+", choices=["demo", "castle"])
    parser.add_argument("--work", type=Path, help="folder in which the reconstructions are kept")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        work = arguments.work or Path(scratch)
        pairs = []
        if "demo" in arguments.buildings:
            origin = SiteOrigin(lon_deg=9.1057, lat_deg=48.7446, height_ellipsoidal_m=482.3)
            pairs.append(
                [
                    reconstruct_campaign(f"demo {c}", DEMO / "campaigns" / c, origin, work)
                    for c in ("2026-04", "2026-10")
                ]
            )
        if "castle" in arguments.buildings:
            origin = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)
            castle = SHARED / "castle"
            pairs.append(
                [
                    reconstruct_campaign(f"castle {n}", castle, origin, work, every_other=k)
                    for k, n in enumerate(("even", "odd"))
                ]
            )
        print("\n" + HEADER)
        for a, b in pairs:
            print(format_row(a, b))
            print(format_row(b, a))
        if len(pairs) == 2:
            print("\n" + check_refusal(pairs[0][0], pairs[1][0]) + "\n\n" + check_refusal(pairs[1][0], pairs[0][0]))


if __name__ == "__main__":
    main()
