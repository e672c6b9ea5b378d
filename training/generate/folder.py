"""Folders of generated pictures, as COCO, which training reads."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from facadelake.reviews.training import Split
from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES, Sample
from training.generate.backgrounds import Backgrounds, load_backgrounds
from training.generate.picture import Picture, make_picture

_backgrounds: Backgrounds | None = None


def write_pictures(data: Path, out: Path, *, count: int, seed: int, side_px: int, workers: int) -> Path:
    """Generate pictures into `out`/images and their boxes into `out`/coco.json.

    Args:
        data: folder with `defects` and `drone`.
        out: folder to write to.
        count: number of pictures.
        seed: seed of the first picture; each further one has the next seed, independently of the number of workers.
        side_px: width and height of a picture.
        workers: number of processes.

    Returns:
        Path of coco.json.
    """
    (out / "images").mkdir(parents=True, exist_ok=True)
    make = partial(_write_one, out=out, side_px=side_px)
    with ProcessPoolExecutor(workers, initializer=_load_backgrounds, initargs=(data,)) as pool:
        pictures = list(pool.map(make, range(seed, seed + count), chunksize=16))
    images: list[dict[str, object]] = []
    annotations: list[dict[str, object]] = []
    for number, (name, boxes, classes) in enumerate(pictures):
        images.append({"id": number, "file_name": name, "width": side_px, "height": side_px})
        for (x0, y0, x1, y1), index in zip(boxes, classes, strict=True):
            box = [x0, y0, x1 - x0, y1 - y0]
            at = len(annotations)
            annotations.append(
                {"id": at, "image_id": number, "category_id": index, "bbox": box, "area": box[2] * box[3], "iscrowd": 0}
            )
    categories = [{"id": index, "name": DefectClass(name).value} for index, name in enumerate(CLASSES)]
    path = out / "coco.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}), "utf-8")
    return path


def read_pictures(out: Path, *, split: Split = Split.TRAIN) -> tuple[Sample, ...]:
    """Samples of a folder in the form of `write_pictures`, of the site `generated/all`."""
    coco = json.loads((out / "coco.json").read_text(encoding="utf-8"))
    boxes_by_image: dict[int, list[tuple[list[float], int]]] = {image["id"]: [] for image in coco["images"]}
    for annotation in coco["annotations"]:
        x, y, width, height = annotation["bbox"]
        boxes_by_image[annotation["image_id"]].append(([x, y, x + width, y + height], annotation["category_id"]))
    return tuple(
        Sample(
            path=out / "images" / Path(image["file_name"]).name,
            boxes_px=np.array([box for box, _ in boxes_by_image[image["id"]]], dtype=np.float64).reshape(-1, 4),
            classes=np.array([index for _, index in boxes_by_image[image["id"]]], dtype=np.int64),
            site="generated/all",
            split=split,
        )
        for image in coco["images"]
    )


def _load_backgrounds(data: Path) -> None:
    global _backgrounds
    cv2.setNumThreads(1)
    _backgrounds = load_backgrounds(data)


def _write_one(seed: int, *, out: Path, side_px: int) -> tuple[str, list[list[float]], list[int]]:
    assert _backgrounds is not None, "a worker is started with _load_backgrounds"
    picture: Picture = make_picture(_backgrounds, seed, side_px=side_px)
    name = f"{seed:07d}.jpg"
    cv2.imwrite(str(out / "images" / name), picture.image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return name, picture.boxes_px.round(2).tolist(), picture.classes.tolist()
