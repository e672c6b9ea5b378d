"""Labels in COCO format: a file with images, annotations and categories."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from facadelake.core.photo_names import PhotoNames
from facadelake.detection import Crosswalk
from facadelake.detection.coco import CocoAnnotation, CocoFile, StoredImage, find_views, parse_shape, read_coco
from facadelake.detection.inference import read_exif_orientation
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledSet, TruthBox, find_photographs

_OTHER_SIZE = "photographs of another size than in the labels (rotated or resized)"
_EXIF_UNKNOWN = "photographs that EXIF turns, where the labels do not tell whether they are of the turned view"


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
    paths = _find_paths(coco, file, root, collector)
    views = find_views(coco, {image_id: stored for image_id, (_, stored) in paths.items()}, None)
    for image_id, (path, stored) in paths.items():
        view = views[image_id]
        if isinstance(view, str):
            collector.left_out[_EXIF_UNKNOWN if stored.orientation != 1 else _OTHER_SIZE] += 1
            continue
        boxes = []
        for annotation in by_image[image_id]:
            defect_class = classes.get(annotation.category_id)
            shape = parse_shape(annotation, view)
            if shape.box is None:
                collector.left_out["boxes that are not four numbers"] += 1
            elif shape.problem and shape.box.width_px > 0 and shape.box.height_px > 0:
                collector.left_out["boxes with a rotation that cannot be used"] += 1
            elif defect_class is None:
                name = coco.categories.get(annotation.category_id, f"category {annotation.category_id}")
                collector.left_out[f"boxes of class '{name}', which has no defect class"] += 1
            else:
                boxes.append(TruthBox(box=shape.box, defect_class=defect_class, ignored=annotation.is_crowd))
        collector.add(path, (stored.width_px, stored.height_px), boxes, labelled)
    return replace(collector.create_set("coco"), source=file)


def _find_paths(
    coco: CocoFile, file: Path, root: Path, collector: LabelCollector
) -> dict[int | str, tuple[Path, StoredImage]]:
    """The photograph of each image that can be read: as the file names it in one of the usual folders, else by its name
    among all photographs below ``root``."""
    folders = list(dict.fromkeys([file.parent, file.parent / "images", root, root / "images"]))
    by_key = {path.relative_to(root).as_posix(): path for path in find_photographs(root)}
    matches = PhotoNames(by_key).match_all(image.file_name for image in coco.images.values())
    found = {}
    for image_id, image in coco.images.items():
        name = image.file_name.replace("\\", "/")
        path = next((folder / name for folder in folders if (folder / name).is_file()), None)
        path = path or by_key.get(matches[image.file_name].photo_id or "")
        if path is None:
            collector.left_out["photographs that do not exist, or whose name matches several"] += 1
            continue
        size = collector.read_size(path)
        if size is not None:
            orientation = read_exif_orientation(path)
            found[image_id] = (path, StoredImage(width_px=size[0], height_px=size[1], orientation=orientation))
    return found
