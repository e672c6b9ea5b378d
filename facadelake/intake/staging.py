"""Copies of an upload under a temporary name beside their place, verified, and put in place by renaming."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import StoreError
from facadelake.core.hashing import compute_key, hash_file
from facadelake.intake.listing import ListedFile, sum_bytes
from facadelake.intake.source import UploadSource

_CHUNK_BYTES = 1 << 20
_SPARE_BYTES = 100 << 20
_STAGING = ".receiving-"
_PARTIAL = ".partial"


@dataclass(frozen=True, kw_only=True)
class StagedCopy:
    """Copied files: the folder, the hashes of what was read, and the ETags of objects, by path."""

    folder: Path
    sha256_of: dict[str, str]
    etag_of: dict[str, str]


def copy_to_staging(
    source: UploadSource, upload: str, files: Sequence[ListedFile], *, parent: Path, fingerprint: str
) -> StagedCopy:
    """Copy files of an upload into a folder that no inspection sees.

    Files that an interrupted pass copied from the same listing are not copied again.

    Args:
        source: the source.
        upload: the folder of the upload in it.
        files: the files to copy.
        parent: folder that the copies are made in, that of the campaign's own.
        fingerprint: that of the upload's listing.

    Returns:
        the copies.

    Raises:
        StoreError: a file cannot be read or written, or has another size than listed; the disk has too little space.
    """
    if not parent.parent.is_dir():  # made anew on a mount point, it would be on another disk
        raise StoreError(
            f"the photographs' folder {parent} cannot be made, as {parent.parent} does not exist; create that, or "
            "mount its disk: it is tried again"
        )
    own = name_staging(source.location, upload)
    folder = parent / f"{own}{fingerprint[:12]}"
    try:
        parent.mkdir(exist_ok=True)
        for leftover in list_staging(parent):
            if leftover.name.startswith(own) and leftover != folder:
                shutil.rmtree(leftover)
        copied = {file.path for file in files if (folder / file.path).is_file()}
        _require_space(parent, sum_bytes([file for file in files if file.path not in copied]))
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise StoreError(_describe_write_error(error, parent)) from error
    staged = StagedCopy(folder=folder, sha256_of={}, etag_of={})
    for file in files:
        try:
            if file.path in copied:
                staged.sha256_of[file.path] = hash_file(folder / file.path)
            else:
                _copy_file(source, upload, file, staged)
        except OSError as error:
            remove_staged(staged)
            raise StoreError(_describe_write_error(error, parent)) from error
    return staged


def name_staging(location: str, upload: str) -> str:
    """How the names of folders begin that an upload is copied to."""
    return f"{_STAGING}{compute_key({'source': location, 'upload': upload})[:12]}-"


def list_staging(parent: Path) -> list[Path]:
    """The folders that uploads were copied to and that are not removed yet."""
    return sorted(parent.glob(f"{_STAGING}*"))


def _copy_file(source: UploadSource, upload: str, file: ListedFile, staged: StagedCopy) -> None:
    target = staged.folder / file.path
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(target.name + _PARTIAL)
    digest, size = hashlib.sha256(), 0
    with source.open_file(upload, file.path) as stream, partial.open("wb") as out:
        staged.etag_of[file.path] = stream.etag
        while chunk := stream.read(_CHUNK_BYTES):
            size += len(chunk)
            digest.update(chunk)
            out.write(chunk)
        out.flush()
        os.fsync(out.fileno())
    if size != file.bytes:
        partial.unlink()
        raise StoreError(
            f"{file.path} has {file.bytes:,} bytes by the listing of {source.location}, and {size:,} were read: it "
            "changed, or the source answers in part"
        )
    partial.replace(target)
    staged.sha256_of[file.path] = digest.hexdigest()


def _require_space(parent: Path, needed_bytes: int) -> None:
    free_bytes = shutil.disk_usage(parent).free
    if needed_bytes and free_bytes < needed_bytes + _SPARE_BYTES:
        raise StoreError(
            f"the disk of {parent} has {free_bytes / 1e9:,.2f} GB free, the upload needs {needed_bytes / 1e9:,.2f} GB "
            f"and {_SPARE_BYTES / 1e9:.1f} GB to spare; free space: it is tried again"
        )


def _describe_write_error(error: OSError, parent: Path) -> str:
    return (
        f"the upload cannot be copied to {parent} ({error.strerror or error}); check the space on its disk, and that "
        "the service may write there: it is tried again"
    )


def find_changed(source: UploadSource, upload: str, staged: StagedCopy, before: Collection[ListedFile]) -> list[str]:
    """The files of an upload that came, went or changed since it was listed, by listing again and by ETag.

    Raises StoreError where the source cannot be read.
    """
    after = source.list_upload(upload)
    changed = {file.path for file in set(after) ^ set(before)}
    etags = {path: etag for path, etag in staged.etag_of.items() if etag and path not in changed}
    return sorted(changed | {path for path, etag in etags.items() if source.read_etag(upload, path) != etag})


def remove_staged(staged: StagedCopy) -> None:
    """Remove copies that are not needed."""
    shutil.rmtree(staged.folder, ignore_errors=True)


def place_new(staged: StagedCopy, target: Path) -> None:
    """Rename the copies to the folder of a campaign that is not there yet: it appears as a whole.

    Raises StoreError where that fails.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        for folder in [staged.folder, *(path for path in staged.folder.rglob("*") if path.is_dir())]:
            _sync_folder(folder)
        staged.folder.replace(target)
        _sync_folder(target.parent)
    except OSError as error:
        raise StoreError(_describe_write_error(error, target.parent)) from error


@dataclass(frozen=True, kw_only=True)
class AddedFiles:
    """What adding files to a campaign's folder did, by their paths.

    ``same``: of equal content there. ``completed``: the file there was the begin of it. ``changed``: the file there has
    another content.
    """

    added: tuple[str, ...]
    same: tuple[str, ...]
    completed: tuple[str, ...]
    changed: tuple[str, ...]


def add_files(staged: StagedCopy, paths: Sequence[str], target: Path, *, replace_changed: bool) -> AddedFiles:
    """Rename copies into the folder of a campaign that is there, each as a whole.

    Args:
        staged: the copies.
        paths: those to add.
        target: folder that they are added to.
        replace_changed: whether files of another content are replaced; else they stay.

    Returns:
        what was done.

    Raises:
        StoreError: a file cannot be read or written.
    """
    found: dict[str, list[str]] = {"added": [], "same": [], "completed": [], "changed": []}
    try:
        for path in paths:
            there = target / path
            outcome = _compare(staged.folder / path, staged.sha256_of[path], there)
            found[outcome].append(path)
            if outcome in ("added", "completed") or (outcome == "changed" and replace_changed):
                there.parent.mkdir(parents=True, exist_ok=True)
                (staged.folder / path).replace(there)
                _sync_folder(there.parent)
    except OSError as error:
        raise StoreError(_describe_write_error(error, target)) from error
    return AddedFiles(**{key: tuple(values) for key, values in found.items()})


def _compare(copy: Path, sha256: str, there: Path) -> str:
    if not there.exists():
        return "added"
    if hash_file(there) == sha256:
        return "same"
    size = there.stat().st_size
    if size >= copy.stat().st_size:
        return "changed"
    with copy.open("rb") as stream, there.open("rb") as begin:
        while chunk := begin.read(_CHUNK_BYTES):
            if stream.read(len(chunk)) != chunk:
                return "changed"
    return "completed"


def _sync_folder(folder: Path) -> None:
    """Write a folder's entries to the disk, so that a power cut leaves the whole campaign or none."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
