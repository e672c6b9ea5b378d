"""Where uploads arrive: a folder, or a prefix of an S3 object store. One code for both, by pyarrow's file systems."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pyarrow import fs

from facadelake.core.errors import StoreError
from facadelake.intake.listing import ListedFile, list_folder, show_name

_S3 = "s3://"
_CONNECT_TIMEOUT_S = 10
_REQUEST_TIMEOUT_S = 60
_DEFAULT_REGION = "us-east-1"  # of object stores that have none
_CREDENTIAL_ERRORS = (
    *("ACCESS_DENIED", "ExpiredToken", "INVALID_ACCESS_KEY_ID", "InvalidAccessKeyId", "SIGNATURE_DOES_NOT_MATCH"),
    *("SignatureDoesNotMatch", "INVALID_CLIENT_TOKEN_ID", "HTTP status 403", "HTTP status 401", "TokenRefreshRequired"),
)


@dataclass(frozen=True, kw_only=True)
class SourceListing:
    """The uploads of a source by the name of their folder, those that cannot be listed, and files that are in none."""

    uploads: Mapping[str, tuple[ListedFile, ...]]
    unreadable: Mapping[str, str]
    loose: tuple[ListedFile, ...]


@dataclass(frozen=True, kw_only=True)
class UploadSource:
    """A source: its location as the portfolio has it, the file system, and the path in that."""

    location: str
    filesystem: fs.FileSystem
    root: str

    def list_uploads(self) -> SourceListing:
        """All files of the source by their upload. Raises StoreError where it cannot be listed."""
        if isinstance(self.filesystem, fs.LocalFileSystem):
            return self._list_folders()
        with self.explain_errors():
            files = list_folder(self.filesystem, self.root)
        uploads: dict[str, list[ListedFile]] = defaultdict(list)
        for file in files:
            folder, _, path = file.path.partition("/")
            if path and not folder.startswith("."):
                uploads[folder].append(ListedFile(path=path, bytes=file.bytes, modified_ns=file.modified_ns))
        return SourceListing(
            uploads={name: tuple(uploads[name]) for name in sorted(uploads)},
            unreadable={},
            loose=tuple(file for file in files if "/" not in file.path),
        )

    def list_upload(self, folder: str) -> tuple[ListedFile, ...]:
        """The files of one upload. Raises StoreError where it cannot be listed."""
        with self.explain_errors():
            return tuple(list_folder(self.filesystem, f"{self.root}/{folder}"))

    def read_start(self, folder: str, path: str, limit_bytes: int) -> bytes:
        """The first bytes of a file. Raises StoreError where it cannot be read."""
        with self.open_file(folder, path) as file:
            return file.read(limit_bytes)

    @contextmanager
    def open_file(self, folder: str, path: str) -> Iterator[OpenedFile]:
        """A file to be read from its begin. Raises StoreError where it cannot be read."""
        with self.explain_errors():
            stream = self.filesystem.open_input_stream(f"{self.root}/{folder}/{path}")
        try:
            yield OpenedFile(source=self, stream=stream)
        finally:
            stream.close()

    def read_etag(self, folder: str, path: str) -> str:
        """The ETag of an object, by which its content is known; empty in a file system."""
        with self.open_file(folder, path) as file:
            return file.etag

    def _list_folders(self) -> SourceListing:
        """Folder by folder, as some may belong to others; one that is empty is an upload, too."""
        with self.explain_errors(), os.scandir(self.root) as entries:
            found = sorted(entries, key=lambda entry: entry.name)
        uploads, unreadable = {}, {}
        for entry in found:
            name = show_name(entry.name)
            if not entry.is_dir(follow_symlinks=False) or name.startswith("."):
                continue
            if name != entry.name:
                unreadable[name] = f"the name of its folder '{name}' is not UTF-8; rename it"
                continue
            try:
                uploads[name] = self.list_upload(name)
            except StoreError as error:
                unreadable[name] = str(error)
        loose = tuple(
            ListedFile(path=show_name(entry.name), bytes=0, modified_ns=0)
            for entry in found
            if entry.is_file(follow_symlinks=False)
        )
        return SourceListing(uploads=uploads, unreadable=unreadable, loose=loose)

    @contextmanager
    def explain_errors(self) -> Iterator[None]:
        """Turn errors of the file system into StoreError, with what to do."""
        try:
            yield
        except OSError as error:
            raise StoreError(self._describe(error)) from error

    def _describe(self, error: OSError) -> str:
        reason = " ".join(str(error).split())
        if not self.location.startswith(_S3):
            remedy = (
                f"create it, or correct 'intake: source' in the portfolio; is its disk or share mounted? ({reason})"
                if not Path(self.root).exists()
                else f"{reason}; check the disk, and that the service may read the folder"
            )
            return f"the source {self.location} cannot be read: {remedy}"
        if any(name in reason for name in _CREDENTIAL_ERRORS):
            remedy = (
                "its credentials are refused or have expired; renew AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and "
                "AWS_SESSION_TOKEN in the environment of the service, which may list and read the bucket"
            )
        elif "NO_SUCH_BUCKET" in reason or "Path does not exist" in reason or "RESOURCE_NOT_FOUND" in reason:
            remedy = "there is no such bucket or prefix; correct 'intake: source' in the portfolio"
        else:
            remedy = "it did not answer, or not in full; check the network, AWS_ENDPOINT_URL and AWS_REGION"
        return f"the source {self.location} cannot be read: {remedy} ({reason})"


@dataclass(frozen=True, kw_only=True)
class OpenedFile:
    """A file of a source while it is read."""

    source: UploadSource
    stream: Any

    @property
    def etag(self) -> str:
        """The ETag of an object; empty for a file of a file system."""
        metadata = {_decode(key).lower(): _decode(value) for key, value in (self.stream.metadata() or {}).items()}
        return metadata.get("etag", "")

    def read(self, size: int) -> bytes:
        """The next bytes, at most ``size``; empty at the end. Raises StoreError where they cannot be read."""
        with self.source.explain_errors():
            return bytes(self.stream.read(size))


def _decode(text: str | bytes) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)


def open_source(location: str) -> UploadSource:
    """The source at a folder, or at ``s3://bucket/prefix``.

    Of an object store, endpoint, region and credentials are those of the environment (AWS_ENDPOINT_URL, AWS_REGION,
    AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN), or of the files and services that AWS documents.
    """
    if not location.startswith(_S3):
        root = str(Path(location).resolve())
        return UploadSource(location=location, filesystem=fs.LocalFileSystem(), root=root)
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    options: dict[str, Any] = {"connect_timeout": _CONNECT_TIMEOUT_S, "request_timeout": _REQUEST_TIMEOUT_S}
    if endpoint:
        address = urlsplit(endpoint if "//" in endpoint else f"https://{endpoint}")
        options |= {"scheme": address.scheme, "endpoint_override": address.netloc + address.path.rstrip("/")}
        region = region or _DEFAULT_REGION
    if region:
        options["region"] = region
    return UploadSource(
        location=location, filesystem=fs.S3FileSystem(**options), root=location.removeprefix(_S3).rstrip("/")
    )
