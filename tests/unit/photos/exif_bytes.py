"""EXIF blocks byte by byte: also what Pillow would refuse to write."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from PIL.TiffImagePlugin import IFDRational

Value = str | bytes | int | IFDRational | Sequence[IFDRational]
Tags = Mapping[int, Value]
_EXIF_POINTER, _GPS_POINTER = 0x8769, 0x8825
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SIGNED_RATIONAL = 1, 2, 3, 4, 5, 10


def _encode(value: Value) -> tuple[int, int, bytes]:
    """Type, count and bytes of a value: bytes are BYTE, texts ASCII, negative fractions SRATIONAL."""
    match value:
        case bytes():
            return _BYTE, len(value), value
        case str():
            text = value.encode("utf-8") + b"\0"
            return _ASCII, len(text), text
        case int():
            return (_SHORT, 1, struct.pack("<H", value)) if value < 2**16 else (_LONG, 1, struct.pack("<L", value))
        case IFDRational():
            value = (value,)
    pairs = [(int(part.numerator), int(part.denominator)) for part in value]
    signed = any(number < 0 for pair in pairs for number in pair)
    data = b"".join(struct.pack("<2l" if signed else "<2L", *pair) for pair in pairs)
    return (_SIGNED_RATIONAL if signed else _RATIONAL), len(pairs), data


def _build_directory(tags: Tags, offset: int) -> bytes:
    """A TIFF directory that begins at ``offset``, with its values behind it."""
    entries, values = b"", b""
    start = offset + 2 + 12 * len(tags) + 4
    for tag, value in sorted(tags.items()):
        kind, count, data = _encode(value)
        if len(data) <= 4:
            entries += struct.pack("<HHL", tag, kind, count) + data.ljust(4, b"\0")
        else:
            entries += struct.pack("<HHLL", tag, kind, count, start + len(values))
            values += data + b"\0" * (len(data) % 2)
    return struct.pack("<H", len(tags)) + entries + b"\0" * 4 + values


def build_exif(*, head: Tags, detail: Tags, gps: Tags) -> bytes:
    """The EXIF block with these tags of its first directory, its Exif block and its GPS block."""
    placeholder = _build_directory({**head, _EXIF_POINTER: 2**20, _GPS_POINTER: 2**20}, 8)
    detail_at = 8 + len(placeholder)
    detail_bytes = _build_directory(detail, detail_at)
    gps_at = detail_at + len(detail_bytes)
    first = {**head, _EXIF_POINTER: detail_at, _GPS_POINTER: gps_at}
    # Pointers are LONG, also where SHORT would do.
    encoded = _build_directory(first, 8)
    for tag, at in ((_EXIF_POINTER, detail_at), (_GPS_POINTER, gps_at)):
        entry = encoded.index(struct.pack("<H", tag), 2)
        encoded = encoded[:entry] + struct.pack("<HHLL", tag, _LONG, 1, at) + encoded[entry + 12 :]
    return b"Exif\0\0II*\0" + struct.pack("<L", 8) + encoded + detail_bytes + _build_directory(gps, gps_at)
