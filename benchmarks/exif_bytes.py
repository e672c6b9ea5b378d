"""EXIF blocks byte by byte: also what Pillow would refuse to write. For tests and the fuzz of metadata."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from PIL.TiffImagePlugin import IFDRational

BYTE, ASCII, SHORT, LONG, RATIONAL, SIGNED_RATIONAL, DOUBLE = 1, 2, 3, 4, 5, 10, 12
_EXIF_POINTER, _GPS_POINTER = 0x8769, 0x8825


@dataclass(frozen=True, kw_only=True)
class ExifEntry:
    """The value of a tag as it is in the file."""

    kind: int
    count: int
    data: bytes


Value = ExifEntry | str | bytes | int | IFDRational | Sequence[IFDRational]
Tags = Mapping[int, Value]


def encode_ratios(pairs: Sequence[tuple[int, int]]) -> ExifEntry:
    """Fractions as RATIONAL, as SRATIONAL where one is negative."""
    signed = any(number < 0 for pair in pairs for number in pair)
    form = "<2l" if signed else "<2L"
    data = b"".join(struct.pack(form, *pair) for pair in pairs)
    return ExifEntry(kind=SIGNED_RATIONAL if signed else RATIONAL, count=len(pairs), data=data)


def _encode(value: Value) -> ExifEntry:
    """The entry of a value: bytes are BYTE, texts ASCII, small numbers SHORT."""
    match value:
        case ExifEntry():
            return value
        case bytes():
            return ExifEntry(kind=BYTE, count=len(value), data=value)
        case str():
            text = value.encode("utf-8") + b"\0"
            return ExifEntry(kind=ASCII, count=len(text), data=text)
        case int():
            return ExifEntry(kind=SHORT, count=1, data=struct.pack("<H", value))
        case IFDRational():
            value = (value,)
    return encode_ratios([(int(part.numerator), int(part.denominator)) for part in value])


def _build_directory(tags: Tags, offset: int) -> bytes:
    """A TIFF directory that begins at ``offset``, with its values behind it."""
    entries, values = b"", b""
    start = offset + 2 + 12 * len(tags) + 4
    for tag, value in sorted(tags.items()):
        entry = _encode(value)
        entries += struct.pack("<HHL", tag, entry.kind, entry.count)
        if len(entry.data) <= 4:
            entries += entry.data.ljust(4, b"\0")
        else:
            entries += struct.pack("<L", start + len(values))
            values += entry.data + b"\0" * (len(entry.data) % 2)
    return struct.pack("<H", len(tags)) + entries + b"\0" * 4 + values


def build_exif(*, head: Tags, detail: Tags, gps: Tags) -> bytes:
    """The EXIF block with these tags of its first directory, its Exif block and its GPS block."""

    def point_to(offset: int) -> ExifEntry:
        return ExifEntry(kind=LONG, count=1, data=struct.pack("<L", offset))

    detail_at = 8 + len(_build_directory({**head, _EXIF_POINTER: point_to(0), _GPS_POINTER: point_to(0)}, 8))
    detail_bytes = _build_directory(detail, detail_at)
    gps_at = detail_at + len(detail_bytes)
    first = _build_directory({**head, _EXIF_POINTER: point_to(detail_at), _GPS_POINTER: point_to(gps_at)}, 8)
    return b"Exif\0\0II*\0" + struct.pack("<L", 8) + first + detail_bytes + _build_directory(gps, gps_at)
