"""Masks beside the photographs, which are no photographs: black is not to be looked at.

Two conventions are known: OpenDroneMap's ``NAME_mask.png`` (or any suffix of a photograph) beside ``NAME.JPG``, and
COLMAP's ``masks/NAME.JPG.png`` below the photographs' folder, where ``masks/NAME.png`` is taken as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

_MASK_SUFFIX = "_mask"
_MASK_FOLDER = "masks"


def pair_masks(paths: Iterable[Path], root: Path) -> Mapping[Path, Path]:
    """The mask of each photograph that has one, among image files ``paths`` below ``root``.

    A file that is named like a mask but whose photograph is not there is taken for a photograph.
    """
    files = sorted(paths)
    of_name = {path.relative_to(root).as_posix(): path for path in files}
    of_stem: dict[str, list[Path]] = {}
    for path in files:
        of_stem.setdefault(path.relative_to(root).with_suffix("").as_posix(), []).append(path)
    found: dict[Path, Path] = {}
    for path in files:
        name = path.relative_to(root)
        stem = name.with_suffix("").as_posix()
        if name.parts[0] == _MASK_FOLDER and path.suffix.lower() == ".png":
            bare = stem.removeprefix(f"{_MASK_FOLDER}/")
            photographs = [of_name[bare]] if bare in of_name else of_stem.get(bare, [])
        elif stem.endswith(_MASK_SUFFIX):
            photographs = of_stem.get(stem.removesuffix(_MASK_SUFFIX), [])
        else:
            continue
        for photograph in photographs:
            found.setdefault(photograph, path)
    return found
