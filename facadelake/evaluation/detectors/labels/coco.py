"""Labels in COCO format: a file with images, annotations and categories."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from facadelake.detection import Box, Crosswalk
from facadelake.detection.coco import CocoAnnotation, CocoImage, bound_segmentation, parse_number, read_coco
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledSet, TruthBox, find_photographs


def read_coco_labels(file: Path, crosswalk: Crosswalk) -> LabelledSet:
    """Read a COCO file. Each category with a defect class counts as labelled in all photographs.

    A photograph is searched by its ``file_name`` beside the file and in ``images`` there or one folder up, then by the
    name alone where only one file has it. A crowd (``iscrowd``) is ignored.
    """
    coco = read_coco(file)
    root = file.parent.parent if file.parent.name.lower() == "annotations" else file.parent
    collector = LabelCollector(root)
    classes = {key: crosswalk.find_defect_class(name) for key, name in coco.categories.items()}
    labelled = frozenset(one for one in classes.values() if one is not None)
    by_image: dict[int | str, list[CocoAnnotation]] = defaultdict(list)
    for annotation in coco.annotations:
        if annotation.image_id not in coco.images:
            collector.left_out["boxes of an image that is not in the file"] += 1
        by_image[annotation.image_id].append(annotation)
    index = _PhotographIndex(root, file.parent)
    for image_id, image in coco.images.items():
        path = index.find(image.file_name)
        if path is None:
            collector.left_out["photographs that do not exist"] += 1
            continue
        size = collector.read_size(path)
        if size is None:
            continue
        if not _is_size_as_stated(image, size):
            collector.left_out["photographs of another size than in the labels (rotated or resized)"] += 1
            continue
        boxes = []
        for annotation in by_image[image_id]:
            defect_class = classes.get(annotation.category_id)
            box = _parse_box(annotation, size)
            if box is None:
                collector.left_out["boxes that are not four numbers"] += 1
            elif defect_class is None:
                name = coco.categories.get(annotation.category_id, f"category {annotation.category_id}")
                collector.left_out[f"boxes of class '{name}', which has no defect class"] += 1
            else:
                boxes.append(TruthBox(box=box, defect_class=defect_class, ignored=annotation.is_crowd))
        collector.add(path, size, boxes, labelled)
    return replace(collector.create_set("coco"), source=file)


class _PhotographIndex:
    """Index of the photographs of a COCO file."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._folders = list(dict.fromkeys([folder, folder / "images", root, root / "images"]))
        self._by_name: dict[str, list[Path]] = defaultdict(list)
        for path in find_photographs(root):
            self._by_name[path.name].append(path)

    def find(self, file_name: str) -> Path | None:
        name = file_name.replace("\\", "/")
        for folder in self._folders:
            if (folder / name).is_file():
                return folder / name
        same_name = self._by_name.get(name.rsplit("/", 1)[-1], [])
        return same_name[0] if len(same_name) == 1 else None


def _is_size_as_stated(image: CocoImage, size: tuple[int, int]) -> bool:
    stated = (image.width_px, image.height_px)
    return None in stated or stated == size


def _parse_box(annotation: CocoAnnotation, size: tuple[int, int]) -> Box | None:
    bbox = annotation.bbox
    if bbox is None:
        bbox = bound_segmentation(annotation.segmentation, *size)
    values = [parse_number(value) for value in bbox] if isinstance(bbox, list) else []
    numbers = [value for value in values if value is not None]
    if len(values) != 4 or len(numbers) != 4:
        return None
    x, y, width, height = numbers
    return Box(x_px=x, y_px=y, width_px=width, height_px=height)
