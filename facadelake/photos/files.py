"""Which files are photographs, which look like photographs and cannot be read, and which are exclusion masks.

Two conventions for masks are supported: OpenDroneMap's ``NAME_mask.png`` (or any suffix of a photograph) beside
``NAME.JPG``, and COLMAP's ``masks/NAME.JPG.png`` below the photographs' folder, where ``masks/NAME.png`` is accepted as
well. Black pixels of a mask are not used.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames

FORMATS_BY_SUFFIX: dict[str, frozenset[str]] = {
    # DJI and others write MPO into .JPG files where a preview follows the photograph.
    ".jpg": frozenset({"JPEG", "MPO"}),
    ".jpeg": frozenset({"JPEG", "MPO"}),
    ".jpe": frozenset({"JPEG", "MPO"}),
    ".jfif": frozenset({"JPEG", "MPO"}),
    ".png": frozenset({"PNG"}),
    ".tif": frozenset({"TIFF"}),
    ".tiff": frozenset({"TIFF"}),
}
_RAW = "raw photographs are not supported; export this one as JPEG or TIFF"
# Neither COLMAP nor OpenCV decodes HEIC; pillow-heif's wheels contain x265, which is under the GPL.
_HEIC = (
    "HEIC and AVIF photographs are not supported; convert this one to JPEG with its EXIF (heif-convert -q 95), and set "
    "the camera to JPEG"
)
_WEBP = (
    "WebP photographs are not supported: COLMAP, which reconstructs the block, does not decode them; use the camera's "
    "original, or convert this one to JPEG with its EXIF and XMP"
)
_OTHER_FORMAT = "pictures of this format are not supported; use the camera's original, or convert this one to JPEG"
_VIDEO = "a video is no photograph; extract frames as JPEG, and give their positions in a file (key 'positions')"
_APPLE_DOUBLE = "a file that macOS writes beside {} for its own metadata; it has no picture: delete it"
_BACKUP = "a backup copy that exiftool wrote of {}; delete it, or move it out of the photographs' folder"
_NO_SUFFIX = "the content is that of a picture but the name has no suffix; rename it, such as to {}.jpg"
_REASONS_BY_SUFFIX: dict[str, str] = {
    **dict.fromkeys(
        (
            *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".gpr", ".iiq", ".kdc", ".mrw"),
            *(".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
        ),
        _RAW,
    ),
    **dict.fromkeys((".avif", ".heic", ".heif", ".hif"), _HEIC),
    ".webp": _WEBP,
    **dict.fromkeys((".bmp", ".gif", ".insp", ".j2k", ".jp2", ".jxl", ".mpo", ".ppm", ".psd", ".seq"), _OTHER_FORMAT),
    **dict.fromkeys((".avi", ".insv", ".m4v", ".mkv", ".mov", ".mp4", ".mts", ".webm"), _VIDEO),
}
_APPLE_DOUBLE_PREFIX = "._"
_BACKUP_SUFFIX = "_original"
# First bytes of JPEG, PNG, TIFF and, from the fifth byte, of HEIC.
_PICTURE_STARTS = (b"\xff\xd8\xff", b"\x89PNG", b"II*\0", b"MM\0*")
_HEIC_START = b"ftyphei"
_MASK_SUFFIX = "_mask"
_MASK_FOLDER = "masks"


def find_photographs(root: Path) -> list[Path]:
    """All files below ``root`` that look like photographs, sorted by path, without masks and hidden files.

    Those that cannot be read are among them, so that each has a row with its reason: see ``explain_unsupported``.
    Raises InputDataError where ``root`` is not a folder.
    """
    images = _list_images(root)
    masks = set(pair_masks(images, root).values())
    return [path for path in images if path not in masks]


def is_photograph_name(name: str) -> bool:
    """Whether a file of this name is a photograph or a mask, or one in a format that is not supported; no video."""
    suffix = Path(name).suffix.lower()
    return suffix in FORMATS_BY_SUFFIX or _REASONS_BY_SUFFIX.get(suffix, _VIDEO) is not _VIDEO


def explain_unsupported(path: Path) -> str:
    """Why a file that looks like a photograph is not read, by its name; empty for one that is read."""
    if path.name.startswith(_APPLE_DOUBLE_PREFIX):
        return _APPLE_DOUBLE.format(path.name.removeprefix(_APPLE_DOUBLE_PREFIX))
    if path.suffix.lower() in FORMATS_BY_SUFFIX:
        return ""
    if path.suffix.lower().endswith(_BACKUP_SUFFIX):
        return _BACKUP.format(path.name[: -len(_BACKUP_SUFFIX)])
    return _REASONS_BY_SUFFIX.get(path.suffix.lower(), _NO_SUFFIX.format(path.name))


def find_masks(root: Path) -> dict[str, Path]:
    """The masks below ``root`` by the photo_id of their photographs: the path below ``root``, with forward slashes."""
    return {photo.relative_to(root).as_posix(): mask for photo, mask in pair_masks(_list_images(root), root).items()}


def _list_images(root: Path) -> list[Path]:
    """All files below ``root`` that look like images, sorted by path, without hidden files and folders."""
    if not root.is_dir():
        raise InputDataError(f"the photographs' folder {root} does not exist; check the path in the portfolio")
    return sorted(path for path in root.rglob("*") if _is_image_like(path, root) and path.is_file())


def _is_image_like(path: Path, root: Path) -> bool:
    *folders, name = path.relative_to(root).parts
    is_hidden = name.startswith(".") and not name.startswith(_APPLE_DOUBLE_PREFIX)
    if is_hidden or any(folder.startswith(".") for folder in folders):
        return False
    suffix = path.suffix.lower().removesuffix(_BACKUP_SUFFIX)
    return suffix in FORMATS_BY_SUFFIX or suffix in _REASONS_BY_SUFFIX or (not suffix and _starts_like_picture(path))


def _starts_like_picture(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            start = file.read(12)
    except OSError:  # a folder, or a file that may not be read
        return False
    return start.startswith(_PICTURE_STARTS) or start[4:].startswith(_HEIC_START)


def pair_masks(paths: Iterable[Path], root: Path) -> Mapping[Path, Path]:
    """The mask of each photograph that has one, among image files ``paths`` below ``root``.

    A file that is named like a mask counts as a photograph where the photograph of that mask does not exist, or several
    match: see ``explain_unused_masks``.
    """
    return {photograph: mask for mask, match in _match_masks(paths, root).items() for photograph in match.photographs}


def explain_unused_masks(root: Path) -> dict[Path, str]:
    """Files below ``root`` that are named like masks and belong to no photograph, with the reason."""
    return {
        mask: f"named like a mask, and used as a photograph: {match.reason}; rename it, or delete it"
        for mask, match in _match_masks(_list_images(root), root).items()
        if not match.photographs
    }


@dataclass(frozen=True, kw_only=True)
class _MaskMatch:
    """The photographs of a mask (those of one name and several suffixes), or why there is none."""

    photographs: tuple[Path, ...] = ()
    reason: str = ""


def _match_masks(paths: Iterable[Path], root: Path) -> Mapping[Path, _MaskMatch]:
    """What becomes of each file that is named like a mask."""
    files = {path.relative_to(root).as_posix(): path for path in sorted(paths)}
    masked = {key: name for key in files if (name := _name_masked(key))}
    names = PhotoNames(key for key in files if key not in masked)
    found: dict[Path, _MaskMatch] = {}
    taken: set[str] = set()
    for key, name in masked.items():
        match = names.match(name)
        candidates = (match.photo_id,) if match.photo_id else match.candidates
        in_folder = {photo_id.rpartition("/")[0] for photo_id in candidates}
        beside = not key.lower().startswith(f"{_MASK_FOLDER}/")
        reason = match.reason
        if beside and in_folder and in_folder != {key.rpartition("/")[0]}:
            reason = f"'{name}' is not beside it; {candidates[0]} is in another folder"
        elif len(in_folder) == 1:
            new = tuple(files[one] for one in candidates if one not in taken)
            taken.update(candidates)
            found[files[key]] = _MaskMatch(photographs=new, reason="" if new else f"'{name}' has another mask")
            continue
        found[files[key]] = _MaskMatch(reason=reason)
    return found


def _name_masked(key: str) -> str:
    """The name of the photograph that a file of this name may be the mask of; empty for other names."""
    stem, suffix = posixpath.splitext(key)
    if key.lower().startswith(f"{_MASK_FOLDER}/") and suffix.lower() == ".png":
        return stem[len(_MASK_FOLDER) + 1 :]
    return stem[: -len(_MASK_SUFFIX)] if stem.lower().endswith(_MASK_SUFFIX) else ""
