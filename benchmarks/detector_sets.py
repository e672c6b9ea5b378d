"""Labelled photographs on which detectors are compared: real cracks by split, facades without defects, and others."""

from __future__ import annotations

import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.foundation import ROOT, SHARED
from benchmarks.published_poses import write_published_poses
from facadelake.building import mask_target_elements, read_registered_model
from facadelake.building.surface import Surface, build_horizontal_distance
from facadelake.core.arrays import BoolArray
from facadelake.core.camera import PosedCamera
from facadelake.core.pose_table import read_posed_cameras
from facadelake.detection import Box, build_crosswalk
from facadelake.evaluation.detectors.labels.labels import (
    LabelCollector,
    LabelledImage,
    LabelledSet,
    TruthBox,
    combine_sets,
    find_photographs,
    open_sound_photographs,
    restrict_to_classes,
)
from facadelake.evaluation.detectors.labels.open import open_labels
from facadelake.evaluation.detectors.labels.sites import assign_scale, assign_sites
from facadelake.georeferencing import SiteFrame
from facadelake.georeferencing.imported import place_imported_poses, read_poses
from facadelake.photos import ingest_photographs
from facadelake.registry import read_portfolio
from schemas.vocabulary import DefectClass
from training.data.evaluation_sets import read_drawn_boxes, write_coco

SITES = ROOT / "training" / "data" / "sites.yaml"
_MASK_GAP_PX, _MASK_SIZE_MIN_PX = 9, 12
_RASTER_WIDTH_PX = 480  # width of the raster over which areas are summed
_INCIDENCE_MAX_DEG = 70.0  # facade at larger incidence does not count as inspected


def open_crack_images(split: str) -> LabelledSet:
    """Real cracks of the sites of a split, of both sets with terms that allow training."""
    crosswalk = build_crosswalk({})
    sets = [
        open_labels(SHARED / "defects" / "crack_boxes_640", crosswalk),
        open_labels(SHARED / "defects" / "omu_quay_crack_yolo", crosswalk, class_names=["crack"]),
    ]
    of_split = [one for one in sets if split in _list_splits(one.name)]
    return combine_sets([assign_sites(one, SITES, split) for one in of_split])


def open_facades() -> LabelledSet:
    """Facades of test buildings, presumed free of defects; their scale was estimated by eye, within about 20 %."""
    sound = assign_sites(open_sound_photographs(SHARED / "defects" / "facade_negatives"), SITES, "test")
    return replace(sound, images=assign_scale(sound.images, SITES.with_name("facade_scale.csv")))


def open_street() -> LabelledSet:
    """Photographs of a street of the test split, presumed free of defects, of unknown scale."""
    return assign_sites(open_sound_photographs(SHARED / "drone" / "lund_street"), SITES, "test")


def open_mould(work: Path) -> LabelledSet:
    """Interiors with and without mould, with our own boxes (training/data/drawn_boxes.yaml), written to ``work``."""
    file = write_coco(read_drawn_boxes(SHARED / "defects"), work / "mould_indoor")
    return restrict_to_classes(open_labels(file, build_crosswalk({})), frozenset({DefectClass.MOISTURE}))


def open_spalling(folder: Path) -> LabelledSet:
    """Boxes of spalling in a COCO folder; its other categories are ignored, because their labels are incomplete."""
    return restrict_to_classes(open_labels(folder, build_crosswalk({})), frozenset({DefectClass.SPALLING}))


def open_masonry() -> LabelledSet:
    """Cracks in masonry, unused in training: boxes of the mask's components, linked over gaps of a few pixels."""
    folder = SHARED / "defects" / "masonry_crack_240" / "dataset"
    collector = LabelCollector(folder)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_MASK_GAP_PX, _MASK_GAP_PX))
    for path in find_photographs(folder / "crack_detection_224_images"):
        mask = cv2.imread(str(folder / "crack_detection_224_masks" / path.name), cv2.IMREAD_GRAYSCALE)
        size = collector.read_size(path)
        if mask is None or size is None:
            continue
        cracked = (mask > 127).astype(np.uint8)
        count, labels = cv2.connectedComponents(cv2.dilate(cracked, reach), connectivity=8)
        boxes = []
        for label in range(1, count):
            rows, columns = np.nonzero((labels == label) & (cracked > 0))
            box = Box(
                x_px=float(columns.min()), y_px=float(rows.min()),
                width_px=float(np.ptp(columns)) + 1, height_px=float(np.ptp(rows)) + 1,
            )  # fmt: skip
            if max(box.width_px, box.height_px) >= _MASK_SIZE_MIN_PX:
                boxes.append(TruthBox(box=box, defect_class=DefectClass.CRACK))
        collector.add(path, size, boxes, frozenset({DefectClass.CRACK}))
    found = collector.create_set("masks")
    images = tuple(replace(one, site="_".join(one.path.stem.split("_")[:2])) for one in found.images)
    return replace(found, name="masonry_crack_240", images=images)


def assign_source_images(labelled: LabelledSet, folder: Path) -> LabelledSet:
    """The set with each patch's source image as its site, where the folder's index.csv states it."""
    index = folder / "index.csv"
    if not index.is_file():
        return labelled
    with index.open(newline="", encoding="utf-8") as stream:
        sources = {row["file"]: row["source_image"] for row in csv.DictReader(stream)}
    return replace(labelled, images=tuple(replace(one, site=sources.get(one.key)) for one in labelled.images))


def open_castle_facade(work: Path) -> LabelledSet:
    """The castle's multi-view photographs with GSD, area and target from its model and published cameras.

    Boxes count only on the model, as in an inspection. The area is the facade at less than 70 degrees of incidence,
    summed over photographs. The plaster is real and presumed free of defects.
    """
    building = read_portfolio(ROOT / "data" / "portfolio.yaml").get_building("castle")
    model = read_registered_model(building)
    surface = Surface(model)
    root = building.locate_photographs("2026-04")
    photos = ingest_photographs(root, distance_to_model_m=build_horizontal_distance(model), close_range_below_m=8.0)
    site_frame = SiteFrame(
        origin=model.origin,
        map_crs=model.map_crs,
        vertical_datum=model.vertical_datum,
        georeference_level=model.georeference_level,
    )
    path = write_published_poses(SHARED / "castle" / "truth", work / "castle-poses.csv", noise=None)
    placed = place_imported_poses(
        read_poses(path), photos, site_frame=site_frame, surface=surface, placement_sigma_max_m=0.5
    )
    is_target = np.append(mask_target_elements(model.elements), False)  # the last entry is for rays without a hit
    images = []
    for photo_id, posed in sorted(read_posed_cameras(placed.poses).items()):
        if "multiview" not in photo_id:
            continue
        target, area, gsd = measure_visible_area(posed, surface, is_target)
        images.append(
            LabelledImage(
                key=photo_id, path=root / photo_id, width_px=posed.camera.width_px, height_px=posed.camera.height_px,
                boxes=(), labelled=frozenset(DefectClass), site="castle", gsd_mm=gsd, area_m2=area, target=target,
            )
        )  # fmt: skip
    return LabelledSet(name="castle", label_format="photographs without defects", images=tuple(images))


def measure_visible_area(posed: PosedCamera, surface: Surface, is_target: BoolArray) -> tuple[BoolArray, float, float]:
    """Measure the part of the building that a photograph shows.

    The area of a pixel on the wall is ``z^2 cos(off axis) / (fx fy cos(incidence))``, without lens distortion.

    Args:
        posed: the photograph's camera.
        surface: the building's surface.
        is_target: which elements are target elements (n,), with a last entry for rays without a hit.

    Returns:
        Where the photograph shows target elements (h, w; reduced resolution), their area in m2 at less than 70 degrees
        of incidence, and their median GSD in mm.
    """
    camera = posed.camera
    width = min(_RASTER_WIDTH_PX, camera.width_px)
    height = round(camera.height_px * width / camera.width_px)
    columns = (np.arange(width) + 0.5) * camera.width_px / width
    rows = (np.arange(height) + 0.5) * camera.height_px / height
    origins, directions = posed.rays_site_from_img(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
    hits = surface.cast(origins, directions)
    off_axis = directions @ posed.site_from_cam.rotation[:, 2]
    depth = hits.distance_m * off_axis
    target = is_target[hits.element]
    facing = np.abs((hits.normal_site * directions).sum(axis=1))
    visible = target & (facing > np.cos(np.radians(_INCIDENCE_MAX_DEG)))
    pixel = (camera.width_px / width) * (camera.height_px / height)
    area = pixel * (depth[visible] ** 2 * off_axis[visible] / (camera.fx_px * camera.fy_px * facing[visible])).sum()
    gsd = 1000 * float(np.median(depth[target])) / camera.fx_px
    return target.reshape(height, width), float(area), gsd


def _list_splits(set_name: str) -> set[str]:
    import yaml

    return {str(entry["split"]) for entry in yaml.safe_load(SITES.read_text(encoding="utf-8"))[set_name].values()}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for one in open_castle_facade(Path(folder)).images:
            print(f"{one.key}: {one.area_m2:.0f} m2, {one.gsd_mm:.1f} mm per pixel")
