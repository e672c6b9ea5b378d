"""Labelled photographs: the common result of the readers of all formats."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from facadelake.core.arrays import BoolArray
from facadelake.core.errors import InputDataError
from facadelake.detection import Box, clip_box
from schemas.vocabulary import DefectClass

PHOTOGRAPH_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"})


@dataclass(frozen=True, kw_only=True)
class TruthBox:
    """A labelled defect, px; an ``ignored`` one (crowd, difficult) counts neither as found nor as missed."""

    box: Box
    defect_class: DefectClass
    ignored: bool = False


@dataclass(frozen=True, kw_only=True)
class LabelledImage:
    """A photograph with all its defects of the classes ``labelled``; other classes are unknown.

    ``key``: its name in figures, the path below the data folder. Boxes are in pixels of the photograph as stored.
    ``site``: the building or source that it shows; ``gsd_mm`` (mm/px) and ``area_m2`` (area of facade that it shows):
    None where unknown. ``target``: a mask of any size over the whole photograph, true on the building; None: the
    building is everywhere.
    """

    key: str
    path: Path
    width_px: int
    height_px: int
    boxes: tuple[TruthBox, ...]
    labelled: frozenset[DefectClass]
    site: str | None = None
    gsd_mm: float | None = None
    area_m2: float | None = None
    target: BoolArray | None = field(default=None, compare=False)


@dataclass(frozen=True, kw_only=True)
class LabelledSet:
    """Labelled photographs of one data set.

    ``left_out``: numbers of photographs and boxes that cannot be used, by reason. ``source``: the file of labels, where
    there is one file.
    """

    name: str
    label_format: str
    images: tuple[LabelledImage, ...]
    left_out: Mapping[str, int] = field(default_factory=dict)
    source: Path | None = None

    @property
    def labelled(self) -> tuple[DefectClass, ...]:
        """The classes that are labelled in a photograph, in the order of the vocabulary."""
        known = frozenset().union(*(image.labelled for image in self.images))
        return tuple(one for one in DefectClass if one in known)

    @property
    def sha256(self) -> str:
        """SHA-256 of names, sizes in bytes and pixels, sites, classes and boxes: what determines the figures."""
        digest = hashlib.sha256()
        for image in sorted(self.images, key=lambda one: one.key):
            boxes = sorted(
                f"{one.defect_class} {one.box.x_px:.2f} {one.box.y_px:.2f} {one.box.width_px:.2f} "
                f"{one.box.height_px:.2f} {one.ignored}"
                for one in image.boxes
            )
            size = image.path.stat().st_size
            head = f"{image.key}\0{size}\0{image.width_px}x{image.height_px}\0{image.site}\0{sorted(image.labelled)}"
            digest.update("\0".join([head, *boxes, "\n"]).encode())
        return digest.hexdigest()


class LabelCollector:
    """Collects the photographs of a reader and counts what it leaves out, by reason."""

    def __init__(self, root: Path) -> None:
        """``root``: the folder from which the photographs' keys start."""
        self.root = root
        self.images: list[LabelledImage] = []
        self.left_out: Counter[str] = Counter()

    def read_size(self, path: Path) -> tuple[int, int] | None:
        """Width and height of a photograph as stored; None, with the reason counted, where it cannot be read."""
        try:
            with Image.open(path) as image:
                width, height = image.size
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
            self.left_out["photographs that cannot be read"] += 1
            return None
        return int(width), int(height)

    def add(
        self, path: Path, size: tuple[int, int], boxes: Sequence[TruthBox], labelled: frozenset[DefectClass]
    ) -> None:
        """Add a photograph. Boxes are clipped to it; those outside or without area are left out and counted.

        Args:
            path: The photograph.
            size: Width and height as stored, px.
            boxes: Its labelled defects.
            labelled: The classes that are labelled in it.
        """
        width, height = size
        kept = []
        for one in boxes:
            if not (one.box.width_px > 0 and one.box.height_px > 0):
                self.left_out["boxes without area"] += 1
                continue
            inside = clip_box(one.box, image_width_px=width, image_height_px=height).inside
            if inside is None:
                self.left_out["boxes outside their photograph"] += 1
                continue
            kept.append(TruthBox(box=inside, defect_class=one.defect_class, ignored=one.ignored))
        self.images.append(
            LabelledImage(
                key=make_key(self.root, path),
                path=path,
                width_px=width,
                height_px=height,
                boxes=tuple(kept),
                labelled=labelled,
            )
        )

    def create_set(self, label_format: str) -> LabelledSet:
        """Create the set. Raises InputDataError where no photograph is left."""
        if not self.images:
            reasons = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())
            raise InputDataError(
                f"{self.root} has no usable labelled photograph of format {label_format} ({reasons or 'none found'}); "
                "give a folder or file in COCO, YOLO or VOC format with its photographs (docs/evaluate-detector.md)"
            )
        images = tuple(sorted(self.images, key=lambda one: one.key))
        return LabelledSet(name=self.root.name, label_format=label_format, images=images, left_out=dict(self.left_out))


def make_key(root: Path, path: Path) -> str:
    """The path below ``root`` with forward slashes; the file name where the file is elsewhere."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


def find_photographs(folder: Path) -> list[Path]:
    """All photographs below a folder, sorted; hidden files and folders are skipped."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in PHOTOGRAPH_SUFFIXES
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


def open_sound_photographs(folder: Path) -> LabelledSet:
    """All photographs below ``folder``, labelled as free of defects. Raises InputDataError where there are none."""
    if not folder.is_dir():
        raise InputDataError(f"photographs without defects: {folder} is not a folder")
    collector = LabelCollector(folder)
    for path in find_photographs(folder):
        size = collector.read_size(path)
        if size is not None:
            collector.add(path, size, [], frozenset(DefectClass))
    return collector.create_set("photographs without defects")


def restrict_to_classes(labelled: LabelledSet, classes: frozenset[DefectClass]) -> LabelledSet:
    """The set with labels of ``classes`` alone; other classes count as unknown, whatever the data lists."""
    images = tuple(
        replace(
            image,
            labelled=image.labelled & classes,
            boxes=tuple(one for one in image.boxes if one.defect_class in classes),
        )
        for image in labelled.images
    )
    return replace(labelled, images=images)


def combine_sets(sets: Sequence[LabelledSet]) -> LabelledSet:
    """Combine sets into one; with several, keys and sites start with the name of their set. Raises InputDataError for
    two sets of one name."""
    if len(sets) == 1:
        return sets[0]
    names = Counter(one.name for one in sets)
    if max(names.values()) > 1:
        raise InputDataError(f"two data sets have the name '{names.most_common(1)[0][0]}'; rename one folder")
    left_out: Counter[str] = Counter()
    images = []
    for one in sets:
        left_out.update(one.left_out)
        for image in one.images:
            site = None if image.site is None else f"{one.name}/{image.site}"
            images.append(replace(image, key=f"{one.name}/{image.key}", site=site))
    formats = "+".join(sorted({one.label_format for one in sets}))
    return LabelledSet(name=" + ".join(names), label_format=formats, images=tuple(images), left_out=dict(left_out))
