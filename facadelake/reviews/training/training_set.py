"""Reviewed campaigns as a training set: pictures, labels in COCO or YOLO form, and a manifest that says whence."""

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
from facadelake.detection.inference import has_exif_rotation, read_photograph
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
    """A reviewed campaign: its photographs' folder, its split, what holds of it, and what to say of it in the manifest.

    ``detectors``: hash by the name of each model or file whose detections were reviewed.
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
    """What was written: pictures, and how many photographs were left out, by reason."""

    folder: Path
    pictures: tuple[TrainingPicture, ...]
    left_out: Mapping[str, int]

    def count_by_class(self, split: Split) -> dict[str, int]:
        """Pictures, those without a defect, and boxes of each class in a split."""
        ours = [picture for picture in self.pictures if picture.split is split]
        boxes = Counter(one.defect_class for picture in ours for one in picture.defects)
        return {
            "pictures": len(ours),
            "negatives": sum(not picture.defects for picture in ours),
            **{str(name): boxes[name] for name in CLASSES},
        }


def write_training_set(
    sources: Sequence[TrainingSource],
    folder: Path,
    *,
    form: TrainingLabelFormat,
    pictures: PictureMode,
    side_px: int,
    terms: str = TERMS,
    version: str = "",
) -> TrainingSet:
    """Write the set to ``folder``, which must not be there or be empty; it appears whole or not at all.

    Tiles hide what nobody has judged; a whole photograph is taken only where every detection in it was judged.
    Raises InputDataError for a folder in use and where there is nothing to learn from, StoreError where the disk fails.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputDataError(
            f"{folder} is there already and not empty; a training set is not written over: name another"
        )
    left_out: Counter[str] = Counter()
    part = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.part"
    try:
        part.mkdir(parents=True)
        for split in Split:
            (part / "images" / split).mkdir(parents=True)
        made = [picture for source in sources for picture in _write_pictures(source, part, pictures, side_px, left_out)]
        if not made:
            reasons = "; ".join(f"{count} {reason}" for reason, count in left_out.items()) or "nothing was reviewed"
            raise InputDataError(
                f"there is nothing to learn from in {', '.join(f'{s.building_id} {s.campaign_id}' for s in sources)} "
                f"({reasons}); 'facadelake review export-task' begins a review"
            )
        write_labels(form, part, made)
        done = TrainingSet(folder=folder, pictures=tuple(made), left_out=dict(left_out))
        _write_sites(part / SITES, made)
        manifest = _build_manifest(done, sources, form, pictures, side_px, terms, version)
        (part / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
        if folder.is_dir():
            folder.rmdir()
        part.rename(folder)
    except OSError as error:
        raise StoreError(
            f"the training set cannot be written to {folder}: {error}; free some space, or name another folder"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    _log.info("%s: %d pictures of %d campaigns", folder, len(made), len(sources))
    return done


def _write_pictures(
    source: TrainingSource, folder: Path, kind: PictureMode, side_px: int, left_out: Counter[str]
) -> Iterator[TrainingPicture]:
    label = f"{source.building_id} {source.campaign_id}"
    for material in track(collect_reviewed_photographs(source.status), label=label):
        path = source.root / material.photo_id
        if kind is not PictureMode.TILES and material.unreviewed:
            left_out["photographs with detections that nobody has judged"] += 1
            continue
        image = read_photograph(path)
        if image is None:
            left_out["photographs that cannot be read"] += 1
            continue
        if kind is not PictureMode.TILES and has_exif_rotation(path):  # most readers would turn it away from its labels
            left_out["photographs that EXIF turns (tiles can be made of them)"] += 1
            continue
        if kind is PictureMode.TILES:
            yield from _write_tiles(source, material, image, folder, side_px)
        else:
            name = f"{source.split}/{_make_stem(source, material)}{path.suffix.lower()}"
            place = folder / "images" / name
            if kind is PictureMode.LINK:
                place.symlink_to(path.resolve())
            else:
                shutil.copyfile(path, place)
            height, width = image.shape[:2]
            yield _create_picture(source, material.photo_id, name, (0, 0, width, height), material.defects)


def _write_tiles(
    source: TrainingSource, material: ReviewedPhotograph, image: UInt8Image, folder: Path, side_px: int
) -> Iterator[TrainingPicture]:
    height, width = image.shape[:2]
    for tile in place_tiles(material, image_width_px=width, image_height_px=height, side_px=side_px):
        frame = (tile.left_px, tile.top_px, tile.width_px, tile.height_px)
        name = f"{source.split}/{_make_stem(source, material)}_{'_'.join(map(str, frame))}.jpg"
        done, data = cv2.imencode(".jpg", crop_tile(tile, image), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not done:
            raise OSError(f"no JPEG could be made of {material.photo_id}")
        (folder / "images" / name).write_bytes(data.tobytes())
        yield _create_picture(source, material.photo_id, name, frame, tile.defects)


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


def _make_stem(source: TrainingSource, material: ReviewedPhotograph) -> str:
    """A file name of its own for every photograph: two folders may hold one name."""
    own = hashlib.sha256(material.photo_id.encode()).hexdigest()[:6]
    return f"{source.building_id}_{source.campaign_id}_{Path(material.photo_id).stem}_{own}"


def _write_sites(path: Path, pictures: Sequence[TrainingPicture]) -> None:
    """Which picture shows which building: what 'facadelake evaluate-detector' takes as sites."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["image", "site", "split"])
        writer.writerows([f"images/{one.name}", one.building_id, str(one.split)] for one in pictures)


def _build_manifest(
    done: TrainingSet,
    sources: Sequence[TrainingSource],
    form: TrainingLabelFormat,
    pictures: PictureMode,
    side_px: int,
    terms: str,
    version: str,
) -> dict[str, Any]:
    return {
        "facadelake": version,
        "form": str(form),
        "pictures": str(pictures),
        "tile_side_px": side_px if pictures is PictureMode.TILES else None,
        "classes": [str(name) for name in CLASSES],
        "terms": terms,
        "splits": {str(split): done.count_by_class(split) for split in Split},
        "split_rule": "by building: chosen, else by the hash of its id",
        "left_out": dict(done.left_out),
        "campaigns": [
            {
                "building_id": source.building_id,
                "campaign_id": source.campaign_id,
                "split": str(source.split),
                "run_id": source.run_id,
                "lake_version": source.version,
                "words": dict(Counter(str(one.review.verdict) for one in source.status.current)),
                "reviewers": sorted({one.review.reviewer for one in source.status.current}),
                "not_reviewed": len(source.status.unreviewed),
                "detectors": dict(source.detectors),
            }
            for source in sources
        ],
    }
