"""Listings of folders, in the file system or an object store: paths, sizes, times of change. Nothing is opened."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from pyarrow import fs

from facadelake.core.hashing import compute_key

# What systems write beside the files of a person, and change without him.
_SYSTEM_FILES = frozenset({".ds_store", "thumbs.db", "desktop.ini", ".localized"})
_SYSTEM_FOLDERS = frozenset({"__macosx", ".spotlight-v100", ".trashes", ".fseventsd", "system volume information"})


@dataclass(frozen=True, kw_only=True)
class ListedFile:
    """A file as it was listed; ``path`` is below the folder, with forward slashes."""

    path: str
    bytes: int
    modified_ns: int

    @property
    def name(self) -> str:
        """Its name without folders."""
        return PurePosixPath(self.path).name


def compute_fingerprint(files: Iterable[ListedFile]) -> str:
    """One text for a listing, which differs where a file came, went, or has another size or time of change."""
    return compute_key({file.path: [file.bytes, file.modified_ns] for file in files})


def list_folder(filesystem: fs.FileSystem, root: str) -> list[ListedFile]:
    """All files below a folder, sorted by path, without what systems write for themselves, and without links.

    Links of a file system are not followed: they can lead in circles, and to files that are no part of the upload.
    Raises OSError where the folder cannot be listed.
    """
    listed = _walk(Path(root)) if isinstance(filesystem, fs.LocalFileSystem) else _list_objects(filesystem, root)
    return sorted((file for file in listed if not _is_of_system(file.path)), key=lambda file: file.path)


def _walk(folder: Path, below: str = "") -> Iterator[ListedFile]:
    with os.scandir(folder) as entries:
        for entry in entries:
            path = below + show_name(entry.name)
            try:
                if entry.is_dir(follow_symlinks=False):
                    yield from _walk(Path(entry.path), f"{path}/")
                elif entry.is_file(follow_symlinks=False):
                    found = entry.stat(follow_symlinks=False)
                    yield ListedFile(path=path, bytes=found.st_size, modified_ns=found.st_mtime_ns)
            except FileNotFoundError:  # it went while the folder was listed, such as a program's temporary file
                continue


def show_name(name: str) -> str:
    """The name of a file as text: bytes that are no UTF-8, such as of an archive of another system, are replaced."""
    return os.fsencode(name).decode("utf-8", "replace")


def _list_objects(filesystem: fs.FileSystem, root: str) -> list[ListedFile]:
    # A prefix under which nothing has arrived yet is not there; a bucket that is not there is a mistake.
    infos = filesystem.get_file_info(fs.FileSelector(root, recursive=True, allow_not_found=True))
    if not infos:
        _require_bucket(filesystem, root.strip("/").partition("/")[0])
    prefix = root.rstrip("/") + "/"
    return [
        ListedFile(path=info.path.removeprefix(prefix), bytes=info.size, modified_ns=info.mtime_ns or 0)
        for info in infos
        if info.type == fs.FileType.File
    ]


def _require_bucket(filesystem: fs.FileSystem, bucket: str) -> None:
    try:
        is_missing = filesystem.get_file_info(bucket).type == fs.FileType.NotFound
    except OSError:  # a policy may allow to list the prefix alone, as was done
        return
    if is_missing:
        raise FileNotFoundError(f"NO_SUCH_BUCKET: there is no bucket '{bucket}', or it may not be seen")


def _is_of_system(path: str) -> bool:
    *folders, name = path.lower().split("/")
    return name in _SYSTEM_FILES or name.startswith("._") or any(folder in _SYSTEM_FOLDERS for folder in folders)


def sum_bytes(files: Sequence[ListedFile]) -> int:
    """The size of all files together."""
    return sum(file.bytes for file in files)
