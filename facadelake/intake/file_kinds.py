"""What of an upload is received, by the names of its files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from enum import StrEnum
from pathlib import PurePosixPath

from facadelake.intake.listing import ListedFile
from facadelake.photos import is_photograph_name

# What surveys and detectors leave beside photographs, and the portfolio can name.
_BESIDE = frozenset({".csv", ".tsv", ".txt", ".mrk", ".pos", ".json"})
# How programs name a file while they write it: browsers, WinSCP, rsync, rclone, Nextcloud, Syncthing.
_UNFINISHED_SUFFIXES = frozenset(
    {".part", ".partial", ".tmp", ".temp", ".crdownload", ".download", ".filepart", ".uploading"}
)
_RSYNC = re.compile(r"\..+\.[A-Za-z0-9]{6}")
_SYNCTHING = re.compile(r"[.~]syncthing[~.].+\.tmp")


LEFT_OUT = "left out"


class FileKind(StrEnum):
    """What becomes of a file of an upload."""

    PHOTOGRAPH = "photograph"
    BESIDE = "beside"  # received with the photographs
    UNFINISHED = "unfinished"  # a transfer that has not ended
    MISNAMED = "misnamed"  # its name is not UTF-8
    LEFT_OUT = "left_out"


def classify_file(file: ListedFile) -> FileKind:
    """The kind of a file by its name; of one without a suffix the content decides, once it is received."""
    path = PurePosixPath(file.path)
    if "\ufffd" in file.path:
        return FileKind.MISNAMED
    if any(part in ("", ".", "..") for part in file.path.split("/")) or "\\" in file.path:
        return FileKind.LEFT_OUT
    if path.suffix.lower() in _UNFINISHED_SUFFIXES or _RSYNC.fullmatch(path.name) or _SYNCTHING.fullmatch(path.name):
        return FileKind.UNFINISHED
    if any(part.startswith((".", "~")) for part in path.parts):
        return FileKind.LEFT_OUT
    if is_photograph_name(path.name):
        return FileKind.PHOTOGRAPH
    return FileKind.BESIDE if path.suffix.lower() in _BESIDE or not path.suffix else FileKind.LEFT_OUT


def describe_left_out(files: Iterable[ListedFile]) -> list[str]:
    """What is not received, in words: kinds by their number, and unfinished transfers by name."""
    files = list(files)
    misnamed = [file.path for file in files if classify_file(file) is FileKind.MISNAMED]
    unfinished = [file.path for file in files if classify_file(file) is FileKind.UNFINISHED]
    suffixes = Counter(
        PurePosixPath(file.path).suffix.lower() or "no suffix"
        for file in files
        if classify_file(file) is FileKind.LEFT_OUT
    )
    lines = []
    if suffixes:
        counted = ", ".join(f"{count} {suffix}" for suffix, count in sorted(suffixes.items()))
        lines.append(f"{LEFT_OUT}, as they are no photographs: {counted}")
    if misnamed:
        lines.append(f"{LEFT_OUT}, as their names are not UTF-8: {_list_first(misnamed)}; rename them")
    if unfinished:
        lines.append(f"{LEFT_OUT}, as their transfer has not ended: {_list_first(unfinished)}; transfer them again")
    return lines


def _list_first(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
