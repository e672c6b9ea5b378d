"""Which files are photographs, and which are their exclusion masks.

Two conventions for masks are supported: OpenDroneMap's ``NAME_mask.png`` (or any suffix of a photograph) beside
``NAME.JPG``, and COLMAP's ``masks/NAME.JPG.png`` below the photographs' folder, where ``masks/NAME.png`` is accepted as
well. Black pixels of a mask are not used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from facadelake.core.errors import InputDataError

FORMATS_BY_SUFFIX: dict[str, frozenset[str]] = {
    # DJI and others write MPO into .JPG files where a preview follows the photograph.
    ".jpg": frozenset({"JPEG", "MPO"}),
    ".jpeg": frozenset({"JPEG", "MPO"}),
    ".png": frozenset({"PNG"}),
    ".tif": frozenset({"TIFF"}),
    ".tiff": frozenset({"TIFF"}),
}
RAW_SUFFIXES = frozenset({".dng"})
_MASK_SUFFIX = "_mask"
_MASK_FOLDER = "masks"


def find_photographs(root: Path) -> list[Path]:
    """All files below ``root`` with the suffix of a photograph, sorted by path, without masks and hidden files.

    Raises InputDataError where ``root`` is not a folder.
    """
    images = _list_images(root)
    masks = set(pair_masks(images, root).values())
    return [path for path in images if path not in masks]


def find_masks(root: Path) -> dict[str, Path]:
    """The masks below ``root`` by the photo_id of their photographs: the path below ``root``, with forward slashes."""
    return {photo.relative_to(root).as_posix(): mask for photo, mask in pair_masks(_list_images(root), root).items()}


def _list_images(root: Path) -> list[Path]:
    """All image files below ``root``, sorted by path, without hidden files and folders."""
    if not root.is_dir():
        raise InputDataError(f"the photographs' folder {root} does not exist; check the path in the portfolio")
    suffixes = FORMATS_BY_SUFFIX.keys() | RAW_SUFFIXES
    return sorted(
        path
        for path in root.rglob("*")
        if path.suffix.lower() in suffixes
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(root).parts)
    )


def pair_masks(paths: Iterable[Path], root: Path) -> Mapping[Path, Path]:
    """The mask of each photograph that has one, among image files ``paths`` below ``root``.

    A file that is named like a mask counts as a photograph where the photograph of that mask does not exist.
    """
    files = sorted(paths)
    by_name = {path.relative_to(root).as_posix(): path for path in files}
    by_stem: dict[str, list[Path]] = {}
    for path in files:
        by_stem.setdefault(path.relative_to(root).with_suffix("").as_posix(), []).append(path)
    found: dict[Path, Path] = {}
    for path in files:
        name = path.relative_to(root)
        stem = name.with_suffix("").as_posix()
        if name.parts[0] == _MASK_FOLDER and path.suffix.lower() == ".png":
            masked = stem.removeprefix(f"{_MASK_FOLDER}/")
            photographs = [by_name[masked]] if masked in by_name else by_stem.get(masked, [])
        elif stem.endswith(_MASK_SUFFIX):
            photographs = by_stem.get(stem.removesuffix(_MASK_SUFFIX), [])
        else:
            continue
        for photograph in photographs:
            found.setdefault(photograph, path)
    return found
