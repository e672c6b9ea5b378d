"""One photograph of a committed campaign beside the virtual view of the model; the lake is read, never changed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface.raycasting import Surface
from facadelake.building.surface.view_images import ViewImages, view_images
from facadelake.building.surface.virtual_view import virtual_photograph
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.pose_table import posed_cameras
from facadelake.core.progress import stage_progress
from facadelake.registry import Building
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.view_sheet import Panels, view_sheet
from flows.committed import committed_model, committed_tables
from flows.precheck import resolved_campaign
from schemas.vocabulary import PoseSource

_USUAL_WIDTH_PX = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoView:
    """What was drawn into which file, and the images it was drawn of."""

    photo_id: str
    path: Path
    images: ViewImages


def view_photograph(
    building: Building, campaign_id: str, photo: str, *, lake: Path, output: Path | None, scale: float | None
) -> PhotoView:
    """Write the sheet of one photograph as a picture, and its images beside it as ``.npz`` (see ``view_images``).

    ``photo`` is a photo_id, or a file name that one photograph alone has. Without ``output`` the sheet goes to
    ``view_<photo>.png`` here; without ``scale`` panels are 1000 pixels wide. Raises InputDataError where the photograph
    has no pose or is not known, StoreError where the lake does not hold the campaign.
    """
    campaign = resolved_campaign(building, campaign_id)
    tables = committed_tables(building, campaign, ["poses"], lake=lake)
    photo_id = _one_of([row["photo_id"] for row in tables["poses"].to_pylist()], photo, building.id, campaign)
    row = next(row for row in tables["poses"].to_pylist() if row["photo_id"] == photo_id)
    posed = posed_cameras(tables["poses"]).get(photo_id)
    if posed is None:
        raise InputDataError(
            f"{photo_id} has no measured pose in {building.id} {campaign} ({row['reason'] or row['pose_source']}), "
            "so there is no view of the model to show; choose another photograph"
        )
    model = committed_model(building, campaign, tables["buildings"].to_pylist()[0])
    surface = Surface(model)
    scale = scale if scale is not None else min(1.0, _USUAL_WIDTH_PX / posed.camera.width_px)
    with stage_progress("Casting rays and rendering"):
        images = view_images(posed, surface, model.elements, scale)
        virtual = virtual_photograph(model, posed, scale=scale).colour
    photograph = _reduced(building.photographs_of(campaign) / photo_id, posed, images.depth_m.shape)
    path = output or Path(f"view_{Path(photo_id).with_suffix('').as_posix().replace('/', '_')}.png")
    figure = view_sheet(
        Panels(photograph=photograph, virtual=virtual, images=images),
        title=f"{building.name}, {campaign}: {photo_id}",
        note=_note(images, row),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    images.save(path.with_suffix(".npz"))
    return PhotoView(photo_id=photo_id, path=path, images=images)


def _one_of(photo_ids: list[str], wanted: str, building_id: str, campaign: str) -> str:
    """The photo_id that is ``wanted``, or the only one that ends so, with or without its suffix."""
    if wanted in photo_ids:
        return wanted
    found = [name for name in photo_ids if wanted in (Path(name).name, Path(name).stem)]
    if len(found) == 1:
        return found[0]
    some = ", ".join((found or photo_ids)[:5])
    raise InputDataError(
        f"{len(found)} photographs of {building_id} {campaign} are called '{wanted}'; write a photo_id such as {some}"
    )


def _reduced(path: Path, posed: PosedCamera, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    reduction = next((n for n in (8, 4, 2) if posed.camera.width_px // n >= shape[1]), 1)
    rgb = read_photograph(path, posed.camera, reduction)
    return np.asarray(cv2.resize(rgb, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _note(images: ViewImages, pose: dict[str, object]) -> str:
    share = float(images.target.mean())
    depth = images.depth_m[images.target]
    nearest = f", {depth.min():.1f} to {depth.max():.1f} m before the camera" if depth.size else ""
    return (
        f"{share:.0%} of the picture shows the building{nearest}; {len(np.unique(images.element[images.target]))} of "
        f"its elements are in sight. Pose: {PoseSource(str(pose['pose_source']))}."
    )
