"""Which files are photographs and which are their exclusion masks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from facadelake.core.errors import InputDataError

FORMATS_BY_SUFFIX: dict[str, frozenset[str]] = {
    # MPO is what DJI and others write into .JPG when a preview follows the photograph.
    ".jpg": frozenset({"JPEG", "MPO"}),
    ".jpeg": frozenset({"JPEG", "MPO"}),
    ".png": frozenset({"PNG"}),
    ".tif": frozenset({"TIFF"}),
    ".tiff": frozenset({"TIFF"}),
}
RAW_SUFFIXES = frozenset({".dng"})


@dataclass(frozen=True, kw_only=True)
class DecodedImage:
    """Size as stored and the metadata blocks of a photograph that decodes to its last row."""

    width_px: int
    height_px: int
    exif: Image.Exif
    xmp: bytes


def find_photographs(root: Path) -> list[Path]:
    """All files below ``root`` whose name says photograph, sorted by path; masks and what is hidden are left out.

    Raises InputDataError where ``root`` is no folder.
    """
    images = _list_images(root)
    masks = set(pair_masks(images, root).values())
    return [path for path in images if path not in masks]


def find_masks(root: Path) -> dict[str, Path]:
    """The masks below ``root`` by the photo_id of their photographs, the path below ``root`` with forward slashes."""
    return {photo.relative_to(root).as_posix(): mask for photo, mask in pair_masks(_list_images(root), root).items()}


def _list_images(root: Path) -> list[Path]:
    """All image files below ``root``, sorted by path; hidden files and folders are left out."""
    if not root.is_dir():
        raise InputDataError(f"photographs' folder {root} does not exist; check the path in the portfolio")
    suffixes = FORMATS_BY_SUFFIX.keys() | RAW_SUFFIXES
    return sorted(
        path
        for path in root.rglob("*")
        if path.suffix.lower() in suffixes
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(root).parts)
    )


def decode_photograph(path: Path) -> DecodedImage:
    """Decode the whole photograph (a truncated file opens well and fails late) and hand back what it says.

    Width and height are those of the stored pixels. The EXIF orientation is *not* applied, neither here nor by
    COLMAP: all pixels of the product (tie points, boxes, control points) are those of the file as stored.
    Raises InputDataError, saying what is wrong with the file.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        raise InputDataError("raw photograph: it must be developed first; export it as JPEG or TIFF")
    if path.stat().st_size == 0:
        raise InputDataError("the file is empty (0 bytes); copy it again from the camera's card")
    allowed = FORMATS_BY_SUFFIX[path.suffix.lower()]
    try:
        with Image.open(path) as image:
            found = image.format or "unknown"
            if found not in allowed:
                raise InputDataError(
                    f"the name ends in {path.suffix} but the content is {found}; such files come from a "
                    "conversion that often loses metadata: export the original again, or give the file its true name"
                )
            image.load()
            width_px, height_px = image.size
            xmp = image.info.get("xmp", b"")
            exif = image.getexif()
    except UnidentifiedImageError as error:
        raise InputDataError("no image format is recognised in the file; copy it again from the card") from error
    except Image.DecompressionBombError as error:
        raise InputDataError(f"the photograph is larger than can be decoded safely: {error}") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise InputDataError(
            f"the photograph does not decode to its end ({error}); copy it again from the card"
        ) from error
    return DecodedImage(
        width_px=width_px, height_px=height_px, exif=exif, xmp=xmp.encode() if isinstance(xmp, str) else bytes(xmp)
    )


def hash_and_size(path: Path) -> tuple[str, int]:
    """SHA-256 in hex and size in bytes of a file."""
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return digest, path.stat().st_size


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
