"""Which files are photographs, which look like photographs and cannot be read, and which are exclusion masks.

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
