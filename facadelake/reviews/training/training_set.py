"""Training set of reviewed campaigns: pictures, labels in COCO or YOLO format, and a manifest of their origin."""

from __future__ import annotations

import csv
import hashlib
import json
import logging
import shutil
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from facadelake.core.arrays import UInt8Image
from facadelake.core.errors import InputDataError, StoreError
from facadelake.core.progress import track
from facadelake.detection.inference import read_exif_orientation, read_photograph
from facadelake.reviews.review_matching import ReviewStatus
from facadelake.reviews.training.label_files import CLASSES, TrainingPicture, write_labels
from facadelake.reviews.training.options import PictureMode, Split, TrainingLabelFormat
from facadelake.reviews.training.reviewed_photographs import (
    ReviewedPhotograph,
    TrainingBox,
    collect_reviewed_photographs,
)
from facadelake.reviews.training.tiles import crop_tile, place_tiles

_log = logging.getLogger(__name__)

MANIFEST, SITES = "manifest.json", "sites.csv"
TERMS = (
    "The photographs belong to whoever took or ordered them and may show persons and neighbours. The set is for the "
    "use that was agreed for the inspection; state its terms here before it is passed on."
)
_JPEG_QUALITY = 95


@dataclass(frozen=True, kw_only=True)
class TrainingSource:
    """A reviewed campaign of a training set.

    ``version``: version of the lake that committed the campaign. ``root``: folder of its photographs. ``detectors``:
    SHA-256 by the name of each model or file whose detections were reviewed.
    """

    building_id: str
    campaign_id: str
    run_id: str
    version: int
    root: Path
    split: Split
    status: ReviewStatus
    detectors: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class TrainingSet:
    """A written training set; ``left_out`` counts the photographs that were left out, by reason."""

    folder: Path
    pictures: tuple[TrainingPicture, ...]
    left_out: Mapping[str, int]

    def count_by_class(self, split: Split) -> dict[str, int]:
        """Numbers of pictures, of pictures without a defect, and of boxes by class in a split."""
        pictures = [picture for picture in self.pictures if picture.split is split]
        boxes = Counter(one.defect_class for picture in pictures for one in picture.defects)
        return {
            "pictures": len(pictures),
            "negatives": sum(not picture.defects for picture in pictures),
            **{str(name): boxes[name] for name in CLASSES},
        }


def write_training_set(
    sources: Sequence[TrainingSource],
    folder: Path,
    *,
    label_format: TrainingLabelFormat,
    pictures: PictureMode,
    side_px: int,
    terms: str = TERMS,
    version: str = "",
) -> TrainingSet:
    """Write a training set; it is complete or not there at all.

    Tiles are grey at detections without a review. A whole photograph is taken only where all its detections have one.

    Args:
        sources: The reviewed campaigns.
        folder: Folder to write; it must not exist, or be empty.
        label_format: Format of the label files.
        pictures: Tiles or whole photographs.
        side_px: Side of a tile.
        terms: Terms of use of the photographs, for the manifest.
        version: Version of Facadelake, for the manifest.

    Raises:
        InputDataError: The folder is not empty, or no photograph can be used.
        StoreError: The set cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputDataError(
            f"{folder} exists and is not empty; a training set is not overwritten: give another folder"
        )
    left_out: Counter[str] = Counter()
    part = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.part"
    try:
        part.mkdir(parents=True)
        for split in Split:
            (part / "images" / split).mkdir(parents=True)
        written = [
            picture for source in sources for picture in _write_pictures(source, part, pictures, side_px, left_out)
        ]
        if not written:
            reasons = "; ".join(f"{count} {reason}" for reason, count in left_out.items()) or "no reviews"
            raise InputDataError(
                f"no training picture in {', '.join(f'{s.building_id} {s.campaign_id}' for s in sources)} "
                f"({reasons}); export a review task with 'facadelake review export-task'"
            )
        write_labels(label_format, part, written)
        training_set = TrainingSet(folder=folder, pictures=tuple(written), left_out=dict(left_out))
        _write_sites(part / SITES, written)
        manifest = _build_manifest(training_set, sources, label_format, pictures, side_px, terms, version)
        (part / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
        if folder.is_dir():
            folder.rmdir()
        part.rename(folder)
    except OSError as error:
        raise StoreError(
            f"the training set cannot be written to {folder}: {error}; free disk space, or give another folder"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    _log.info("%s: %d pictures of %d campaigns", folder, len(written), len(sources))
    return training_set


def _write_pictures(
    source: TrainingSource, folder: Path, pictures: PictureMode, side_px: int, left_out: Counter[str]
) -> Iterator[TrainingPicture]:
    label = f"{source.building_id} {source.campaign_id}"
    for photograph in track(collect_reviewed_photographs(source.status), label=label):
        path = source.root / photograph.photo_id
        if pictures is not PictureMode.TILES and photograph.unreviewed:
            left_out["photographs with detections without a review"] += 1
            continue
        image = read_photograph(path)
        if image is None:
            left_out["photographs that cannot be read"] += 1
            continue
        # Most readers would rotate the photograph, but not its labels.
        if pictures is not PictureMode.TILES and read_exif_orientation(path) != 1:
            left_out["photographs with an EXIF rotation (use tiles for them)"] += 1
            continue
        if pictures is PictureMode.TILES:
            yield from _write_tiles(source, photograph, image, folder, side_px)
        else:
            name = f"{source.split}/{_make_stem(source, photograph)}{path.suffix.lower()}"
            target = folder / "images" / name
            if pictures is PictureMode.LINK:
                target.symlink_to(path.resolve())
            else:
                shutil.copyfile(path, target)
            height, width = image.shape[:2]
            yield _create_picture(source, photograph.photo_id, name, (0, 0, width, height), photograph.defects)


def _write_tiles(
    source: TrainingSource, photograph: ReviewedPhotograph, image: UInt8Image, folder: Path, side_px: int
) -> Iterator[TrainingPicture]:
    height, width = image.shape[:2]
    for tile in place_tiles(photograph, image_width_px=width, image_height_px=height, side_px=side_px):
        frame = (tile.left_px, tile.top_px, tile.width_px, tile.height_px)
        name = f"{source.split}/{_make_stem(source, photograph)}_{'_'.join(map(str, frame))}.jpg"
        encoded, data = cv2.imencode(".jpg", crop_tile(tile, image), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not encoded:
            raise OSError(f"no JPEG can be encoded of {photograph.photo_id}")
        (folder / "images" / name).write_bytes(data.tobytes())
        yield _create_picture(source, photograph.photo_id, name, frame, tile.defects)


def _create_picture(
    source: TrainingSource, photo_id: str, name: str, frame: tuple[int, int, int, int], defects: tuple[TrainingBox, ...]
) -> TrainingPicture:
    left, top, width, height = frame
    return TrainingPicture(
        name=name,
        split=source.split,
        building_id=source.building_id,
        campaign_id=source.campaign_id,
        photo_id=photo_id,
        left_px=left,
        top_px=top,
        width_px=width,
        height_px=height,
        defects=defects,
    )


def _make_stem(source: TrainingSource, photograph: ReviewedPhotograph) -> str:
    """The stem of a unique file name: two folders may hold photographs of one name."""
    digest = hashlib.sha256(photograph.photo_id.encode()).hexdigest()[:6]
    return f"{source.building_id}_{source.campaign_id}_{Path(photograph.photo_id).stem}_{digest}"


def _write_sites(path: Path, pictures: Sequence[TrainingPicture]) -> None:
    """Write the building of each picture as its site, for 'facadelake evaluate-detector --sites'."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["image", "site", "split"])
        writer.writerows([f"images/{one.name}", one.building_id, str(one.split)] for one in pictures)


def _build_manifest(
    training_set: TrainingSet,
    sources: Sequence[TrainingSource],
    label_format: TrainingLabelFormat,
    pictures: PictureMode,
    side_px: int,
    terms: str,
    version: str,
) -> dict[str, Any]:
    return {
        "facadelake": version,
        "form": str(label_format),
        "pictures": str(pictures),
        "tile_side_px": side_px if pictures is PictureMode.TILES else None,
        "classes": [str(name) for name in CLASSES],
        "terms": terms,
        "splits": {str(split): training_set.count_by_class(split) for split in Split},
        "split_rule": "by building: as chosen, else by the hash of its id",
        "left_out": dict(training_set.left_out),
        "campaigns": [
            {
                "building_id": source.building_id,
                "campaign_id": source.campaign_id,
                "split": str(source.split),
                "run_id": source.run_id,
                "lake_version": source.version,
                "reviews": dict(Counter(str(one.review.verdict) for one in source.status.current)),
                "reviewers": sorted({one.review.reviewer for one in source.status.current}),
                "not_reviewed": len(source.status.unreviewed),
                "detectors": dict(source.detectors),
            }
            for source in sources
        ],
    }
