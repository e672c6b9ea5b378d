"""Fuzz the reader of EXIF and XMP: no traceback, and no position accepted without a warning that exiftool contradicts.

    .venv/bin/python -m benchmarks.fuzz_metadata [--inputs 10000] [--keep FOLDER]

Hypothesis (of the development environment) generates small JPEGs with a GPS block and a packet of DJI's XMP in many
forms, some of them damaged; the inputs are the same in every run. The oracle is exiftool (Debian:
libimage-exiftool-perl), where it is installed; without it only tracebacks are counted, and the output says so.

A result is *silently wrong* where position, height or RTK flag is used without a warning, and differs from the oracle's
(1e-7 deg, 1 mm), or where the oracle reads a position in XMP that is not used and nothing says why.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import re
import shutil
import struct
import subprocess
import tempfile
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from PIL import Image

from benchmarks.exif_bytes import DOUBLE, SHORT, ExifEntry, Value, build_exif, encode_ratios
from facadelake.photos.position_prior import PositionPrior
from facadelake.photos.priors import PhotoMetadata, derive_priors
from facadelake.photos.read import read_photos
from schemas.vocabulary import PositionSource

_POSITION_DEG, _HEIGHT_M = 1e-7, 1e-3
_SHOWN_MAX = 10


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What became of one input: ``outcome`` and, for a fault, what is wrong."""

    outcome: str
    fault: str = ""


# ---------------------------------------------------------------- generated EXIF


@st.composite
def _draw_angle(draw: st.DrawFn, largest_deg: int) -> Value:
    """An angle in one of the forms that are found in files, and in some that are not."""
    degrees, minutes = draw(st.integers(0, largest_deg)), draw(st.integers(0, 59))
    seconds = draw(st.integers(0, 599_999))  # of 1/10,000 of a second
    sign = draw(st.sampled_from([1] * 9 + [-1]))
    forms: list[list[tuple[int, int]]] = [
        [(sign * degrees, 1), (minutes, 1), (seconds, 10_000)],
        [(sign * degrees, 1), (sign * minutes, 1), (sign * seconds, 10_000)],
        [(sign * degrees, 1), (minutes * 10_000 + seconds % 10_000, 10_000), (0, 1)],
        [(sign * degrees, 1), (minutes * 10_000 + seconds % 10_000, 10_000), (0, 0)],
        [(sign * degrees, 1), (minutes * 10_000 + seconds % 10_000, 10_000)],
        [(sign * (degrees * 1_000_000 + seconds), 1_000_000)],
        [(sign * (degrees * 1_000_000 + seconds), 1_000_000), (0, 1), (0, 1)],
        [(sign * (degrees * 1_000_000 + seconds), 1_000_000), (0, 0), (0, 0)],
        [(sign * (degrees * 1_000_000 + seconds), 1_000_000), (minutes, 1), (0, 1)],
        [(degrees, 1), (minutes, 1), (0, 0)],
        [(degrees, 1), (minutes + 40, 1), (seconds, 10_000)],
        [(0, 0), (minutes, 1), (seconds, 10_000)],
        [(degrees * 100 + minutes, 1)],
        [(0, 0), (0, 0), (0, 0)],
        [(degrees, 1), (minutes, 1), (seconds, 10_000), (1, 1)],
    ]
    weights = [0, 4, 5] * 12 + list(range(len(forms)))
    pairs = forms[draw(st.sampled_from(weights))]
    other = draw(st.integers(0, 59))
    if other == 17:
        return f"{degrees} {minutes} {seconds / 10_000}"
    if other == 27:
        return ExifEntry(kind=DOUBLE, count=3, data=struct.pack("<3d", degrees, minutes, seconds / 10_000))
    if other == 37:
        return ExifEntry(kind=SHORT, count=3, data=struct.pack("<3H", degrees, minutes, seconds // 10_000))
    return encode_ratios(pairs)


_LAT_REFS = (*("N", "S") * 10, "n", "s", "North", "South", "", "E", "-", "\0", "Süd", " S", "S ", "NS")
_LON_REFS = (*("E", "W") * 10, "e", "w", "East", "West", "", "N", "+", "\0", "Ost", " W", "W ", "WE")
_ALTITUDE_REFS: tuple[Value | None, ...] = (
    b"\0", b"\1", b"\0", b"\2", b"\3", b"0",
    b"1", b"\x09", "0", "1", "Below Sea Level",
    "Above Sea Level", "unten", 1, None,
)  # fmt: skip


@st.composite
def _draw_gps(draw: st.DrawFn) -> dict[int, Value]:
    tags: dict[int, Value] = {}
    for number, refs, largest_deg in ((1, _LAT_REFS, 90), (3, _LON_REFS, 180)):
        if draw(st.integers(0, 29)) != 17:
            tags[number] = draw(st.sampled_from(refs))
        if draw(st.integers(0, 29)) != 17:
            tags[number + 1] = draw(_draw_angle(largest_deg))
    ref = draw(st.sampled_from(_ALTITUDE_REFS))
    if ref is not None:
        tags[5] = ref
    if draw(st.integers(0, 4)) != 3:
        tags[6] = encode_ratios([(draw(st.integers(-40_000, 300_000)), draw(st.sampled_from([100, 1000, 1, 0])))])
    return tags


# ---------------------------------------------------------------- generated XMP


@st.composite
def _draw_xmp(draw: st.DrawFn) -> bytes:
    lat, lon = draw(st.integers(-91_000_000, 91_000_000)) / 1e6, draw(st.integers(-181_000_000, 181_000_000)) / 1e6
    height = draw(st.integers(-40_000, 300_000)) / 100
    properties = {
        "GpsStatus": draw(st.sampled_from([*("RTK", "Normal") * 6, "Invalid", "a &amp; b", "\u00b0"])),
        "GpsLatitude": draw(st.sampled_from([f"{lat:+.8f}", f"{lat:.6f}", f"{lat}", f"{lat:.6f}".replace(".", ",")])),
        draw(st.sampled_from(["GpsLongitude", "GpsLongtitude"])): f"{lon:+.8f}",
        "AbsoluteAltitude": draw(st.sampled_from([f"{height:+.2f}", f"{height:.2f}", "n/a"])),
        "RtkFlag": draw(st.sampled_from(["50", "50", "34", "16", "0"])),
        "RtkStdLon": "0.010",
        "RtkStdLat": "0.011",
        "RtkStdHgt": "0.020",
        "SelfData": draw(st.sampled_from(["", "plain", "a & b", "a\x01b", "a\0", "<x>", "\u00e9", "'", "]]>"])),
    }
    names = draw(st.permutations([name for name in properties if draw(st.integers(0, 39)) != 17]))
    namespace = draw(st.sampled_from(["http://www.dji.com/drone-dji/1.0/", "http://www.dji.com/drone-dji/1.0"]))
    if draw(st.booleans()):
        inside = " ".join(f'drone-dji:{name}="{properties[name]}"' for name in names) + "/>"
    else:
        inside = ">" + "".join(f"<drone-dji:{n}>{properties[n]}</drone-dji:{n}>" for n in names) + "</rdf:Description>"
    head = "<?xpacket begin='\ufeff' id='W5M0MpCehiHzreSzNTczkc9d'?>\n"
    text = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="DJI Meta Data" xmlns:drone-dji="{namespace}" {inside}</rdf:RDF></x:xmpmeta>'
    )
    packet = bytearray((head + text + "\n<?xpacket end='w'?>").encode())
    for _ in range(draw(st.sampled_from([0, 0, 0, 1, 1, 2, 4]))):
        at = draw(st.integers(len(head), len(packet) - 1))
        match draw(st.integers(0, 6)):
            case 0:
                packet[at] = draw(st.integers(0, 255))
            case 1:
                del packet[at]
            case 2:
                packet.insert(at, draw(st.sampled_from(b"&\0\x01<>\"'\xb0 =")))
            case 3:
                del packet[at : at + draw(st.integers(1, 40))]
            case 4:
                packet = packet[:at]
            case 5:
                name = draw(st.sampled_from(sorted(properties)))
                found = packet.find(b"RtkStd")
                if found > 0:
                    packet[found - 10 : found - 10] = f' drone-dji:{name}="{draw(st.integers(0, 60))}" '.encode()
            case 6:
                packet[at : at + 1] = packet[at : at + draw(st.integers(2, 60))]
        if len(packet) <= len(head):
            break
    return bytes(packet)


@st.composite
def _draw_photograph(draw: st.DrawFn) -> bytes:
    """A JPEG with EXIF, XMP, or both."""
    segments = []
    has_exif, has_xmp = draw(st.sampled_from([(True, False), (False, True), (True, True)]))
    if has_exif:
        exif = bytearray(build_exif(head={271: "Maker", 272: "Model"}, detail={}, gps=draw(_draw_gps())))
        if draw(st.integers(0, 7)) == 3:  # damaged
            for _ in range(draw(st.integers(1, 3))):
                exif[draw(st.integers(6, len(exif) - 1))] = draw(st.integers(0, 255))
            if draw(st.booleans()):
                exif = exif[: draw(st.integers(14, len(exif)))]
        segments.append(bytes(exif))
    if has_xmp:
        segments.append(b"http://ns.adobe.com/xap/1.0/\0" + draw(_draw_xmp()))
    return _EMPTY[:2] + b"".join(b"\xff\xe1" + struct.pack(">H", len(s) + 2) + s for s in segments) + _EMPTY[2:]


def _make_empty_jpeg() -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (8, 8), (90, 80, 70)).save(out, "JPEG")
    return out.getvalue()


_EMPTY = _make_empty_jpeg()


def draw_inputs(count: int) -> list[bytes]:
    """The same inputs in every run."""
    found: list[bytes] = []

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    @given(_draw_photograph())
    def collect(photograph: bytes) -> None:
        found.append(photograph)

    collect()
    return found


# ---------------------------------------------------------------- oracle and comparison


def read_with_exiftool(folder: Path) -> dict[str, dict[str, Any]]:
    """The tags of all files below the folder by name, as exiftool reads them."""
    tags = ("GPSLatitude", "GPSLatitudeRef", "GPSLongitude", "GPSLongitudeRef", "GPSAltitude", "GPSAltitudeRef")
    arguments = [
        "exiftool",
        "-j",
        "-n",
        "-q",
        "-q",
        "-m",
        "-G1",
        *(f"-GPS:{tag}" for tag in tags),
        "-XMP-drone-dji:all",
        "-Warning",
    ]
    done = subprocess.run([*arguments, str(folder)], capture_output=True, text=True, check=False)
    return {Path(entry["SourceFile"]).name: entry for entry in json.loads(done.stdout)}


def _parse_number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def _read_oracle(tags: dict[str, Any], source: str) -> tuple[float, float, float]:
    """Longitude, latitude and height by exiftool; its composite tags make the sign of EXIF in the same way."""
    if source == "xmp":
        names = ("GPSLongitude", "GPSLatitude", "AbsoluteAltitude")
        lon, lat, height = (_parse_number(tags.get(f"XMP-drone-dji:{name}")) for name in names)
        if math.isnan(lon):
            lon = _parse_number(tags.get("XMP-drone-dji:GPSLongtitude"))
        return lon, lat, height
    lon, lat, height = (
        _parse_number(tags.get(f"GPS:{name}")) for name in ("GPSLongitude", "GPSLatitude", "GPSAltitude")
    )
    lon = -lon if str(tags.get("GPS:GPSLongitudeRef", "")).strip().upper().startswith("W") else lon
    lat = -lat if str(tags.get("GPS:GPSLatitudeRef", "")).strip().upper().startswith("S") else lat
    # 49 is the letter 1 in a tag of type BYTE.
    below = str(tags.get("GPS:GPSAltitudeRef", "")).strip() in ("1", "3", "49", "Below Sea Level")
    return lon, lat, -height if below else height


def _find_text(packet: bytes, name: str) -> float:
    found = re.search(rb"drone-dji:" + name.encode() + rb"""(?:=["']|>)([^"'<]*)""", packet)
    return _parse_number(found[1].decode("latin-1")) if found else math.nan


def _judge(
    position: PositionPrior, rtk_flag: int | None, warnings: Sequence[str], tags: dict[str, Any], packet: bytes
) -> Finding:
    by_xmp = _read_oracle(tags, "xmp")
    is_stated = abs(by_xmp[0]) <= 180 and abs(by_xmp[1]) <= 90 and any(by_xmp[:2])
    is_lost = is_stated and str(tags.get("XMP-drone-dji:GpsStatus", "")).lower() != "invalid"
    if position.source is PositionSource.NONE:
        if is_lost and not warnings:
            return Finding(outcome="silently wrong", fault=f"not used; exiftool reads XMP {by_xmp[1]}, {by_xmp[0]}")
        return Finding(outcome="no position, with a reason")
    if warnings:
        return Finding(outcome=f"{position.source.upper()} used, with a warning")
    if position.source is PositionSource.XMP and not any(tag.startswith("XMP-drone-dji:Rtk") for tag in tags):
        # Well-formed, else there was a warning; exiftool has no "]]>" in attributes and no quote in a namespace.
        texts = [_find_text(packet, name) for name in ("GpsLatitude", "GpsLongitude", "GpsLongtitude")]
        if position.lat_deg == texts[0] and position.lon_deg in texts[1:]:
            return Finding(outcome="XMP used, well-formed, which exiftool does not read")
    lon, lat, height = _read_oracle(tags, position.source)
    faults = []
    if not (abs(position.lon_deg - lon) <= _POSITION_DEG and abs(position.lat_deg - lat) <= _POSITION_DEG):
        faults.append(f"position {position.lat_deg}, {position.lon_deg}; exiftool {lat}, {lon}")
    height = by_xmp[2] if math.isfinite(by_xmp[2]) else _read_oracle(tags, "exif")[2]
    if math.isfinite(position.height_m) and not abs(position.height_m - height) <= _HEIGHT_M:
        faults.append(f"height {position.height_m}; exiftool {height}")
    stated_flag = _parse_number(tags.get("XMP-drone-dji:RtkFlag"))
    if (rtk_flag is not None or math.isfinite(stated_flag)) and rtk_flag != stated_flag:
        faults.append(f"RtkFlag {rtk_flag}; exiftool {stated_flag}")
    if position.source is PositionSource.EXIF and is_lost:
        faults.append(f"EXIF used; exiftool reads XMP {by_xmp[1]}, {by_xmp[0]}")
    if faults:
        return Finding(outcome="silently wrong", fault="; ".join(faults))
    return Finding(outcome=f"{position.source.upper()} used, as exiftool reads it")


def _read_and_judge(path: Path, tags: dict[str, Any] | None) -> Finding:
    (photo,) = read_photos([path])
    if photo.exif is None:
        return Finding(outcome="unreadable, with a reason")
    metadata = PhotoMetadata(
        photo_id=path.name,
        width_px=photo.width_px,
        height_px=photo.height_px,
        exif=photo.exif,
        drone=photo.drone,
        warnings=photo.metadata_warnings,
    )
    (priors,) = derive_priors([metadata])
    if tags is None:
        return Finding(outcome="read; no oracle")
    return _judge(
        priors.position, photo.drone.rtk_flag if photo.drone else None, priors.warnings, tags, path.read_bytes()
    )


def fuzz_metadata(count: int, folder: Path) -> Counter[str]:
    """Write the inputs into ``folder``, read and compare them; prints faults, returns counts by outcome."""
    paths = []
    for number, content in enumerate(draw_inputs(count)):
        paths.append(folder / f"{number:05d}.jpg")
        paths[-1].write_bytes(content)
    oracle = read_with_exiftool(folder) if shutil.which("exiftool") else None
    counts: Counter[str] = Counter()
    shown = 0
    for path in paths:
        try:
            finding = _read_and_judge(path, None if oracle is None else oracle.get(path.name, {}))
        except Exception:
            finding = Finding(outcome="traceback", fault=traceback.format_exc())
        counts[finding.outcome] += 1
        if finding.fault and shown < _SHOWN_MAX:
            shown += 1
            print(f"{path.name}: {finding.outcome}: {finding.fault}")
    return counts


def main() -> None:
    """Print the number of inputs by outcome; exit status 1 where there is a traceback or a silently wrong result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--keep", type=Path, help="folder to write the inputs into, and to leave them in")
    arguments = parser.parse_args()
    if shutil.which("exiftool") is None:
        print("exiftool is not installed (apt-get install libimage-exiftool-perl): tracebacks alone are counted")
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        counts = fuzz_metadata(arguments.inputs, folder)
    for outcome, number in counts.most_common():
        print(f"{number:6d}  {outcome}")
    raise SystemExit(1 if counts["traceback"] or counts["silently wrong"] else 0)


if __name__ == "__main__":
    main()
