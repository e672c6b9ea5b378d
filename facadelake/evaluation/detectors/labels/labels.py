"""Labelled photographs: what a reader of any format gives, and what it had to leave out."""

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
    """A labelled defect; an ``ignored`` one (a crowd, a difficult one) neither counts as found nor as missed."""

    box: Box
    defect_class: DefectClass
    ignored: bool = False


@dataclass(frozen=True, kw_only=True)
class LabelledImage:
    """A photograph with all its defects of the classes ``labelled``; of other classes nothing is known.

    ``key`` is its name in figures (the path below the data folder); pixels are those of the photograph as stored.
    ``site`` is the building or source it shows, None where nobody said. ``gsd_mm`` (mm a pixel) and ``area_m2``
    (facade to be seen in it) are None where nobody said. ``target``, a mask of any size over the whole photograph, is
    true where it shows the building; None: everywhere.
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
    """Photographs with labels; ``left_out`` counts what could not be used, by reason in words; ``source`` is the one
    file of labels, where it is one."""

    name: str
    label_format: str
    images: tuple[LabelledImage, ...]
    left_out: Mapping[str, int] = field(default_factory=dict)
    source: Path | None = None

    @property
    def labelled(self) -> tuple[DefectClass, ...]:
        """The classes that some photograph has labels of, in the vocabulary's order."""
        known = frozenset().union(*(image.labelled for image in self.images))
        return tuple(one for one in DefectClass if one in known)

    @property
    def sha256(self) -> str:
        """Hash of names, sizes in bytes and pixels, sites, classes and boxes: the same set gives the same figures."""
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
    """Collects a reader's photographs and counts, by reason, what it leaves out."""

    def __init__(self, root: Path) -> None:
        """``root`` is the folder below which photographs are named."""
        self.root = root
        self.images: list[LabelledImage] = []
        self.left_out: Counter[str] = Counter()

    def read_size(self, path: Path) -> tuple[int, int] | None:
        """Width and height as stored, or None with the reason counted."""
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
        """Take a photograph; boxes are cut to it, those outside or without size are left out and counted."""
        width, height = size
        kept = []
        for one in boxes:
            if not (one.box.width_px > 0 and one.box.height_px > 0):
                self.left_out["boxes of no size"] += 1
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

    def create_set(self, form: str) -> LabelledSet:
        """The set. Raises InputDataError where no photograph is left."""
        if not self.images:
            reasons = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())
            raise InputDataError(
                f"{self.root} holds no labelled photograph of form {form} to be used ({reasons or 'none found'}); "
                "give a folder or file in COCO, YOLO or VOC form with its photographs (docs/evaluate-detector.md)"
            )
        images = tuple(sorted(self.images, key=lambda one: one.key))
        return LabelledSet(name=self.root.name, label_format=form, images=images, left_out=dict(self.left_out))


def make_key(root: Path, path: Path) -> str:
    """The path below ``root`` with forward slashes; the file's name where it lies elsewhere."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


def find_photographs(folder: Path) -> list[Path]:
    """All photographs below a folder, in order; hidden files and folders are passed over."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in PHOTOGRAPH_SUFFIXES
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


def open_sound_photographs(folder: Path) -> LabelledSet:
    """All photographs below ``folder`` as free of defects of any class. Raises InputDataError where there are none."""
    if not folder.is_dir():
        raise InputDataError(f"photographs without defects: {folder} is no folder")
    gathered = LabelCollector(folder)
    for path in find_photographs(folder):
        size = gathered.read_size(path)
        if size is not None:
            gathered.add(path, size, [], frozenset(DefectClass))
    return gathered.create_set("photographs without defects")


def restrict_to_classes(labelled: LabelledSet, classes: frozenset[DefectClass]) -> LabelledSet:
    """The set with labels of ``classes`` alone: of others nothing is known, whatever its list of classes says."""
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
    """Several sets as one: keys begin with their set's name where there is more than one, sites too."""
    if len(sets) == 1:
        return sets[0]
    names = Counter(one.name for one in sets)
    if max(names.values()) > 1:
        raise InputDataError(f"two of the data sets are both named '{names.most_common(1)[0][0]}'; rename one folder")
    left_out: Counter[str] = Counter()
    images = []
    for one in sets:
        left_out.update(one.left_out)
        for image in one.images:
            site = None if image.site is None else f"{one.name}/{image.site}"
            images.append(replace(image, key=f"{one.name}/{image.key}", site=site))
    forms = "+".join(sorted({one.label_format for one in sets}))
    return LabelledSet(name=" + ".join(names), label_format=forms, images=tuple(images), left_out=dict(left_out))
