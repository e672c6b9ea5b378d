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
import json
import math
import re
import shutil
import subprocess
import tempfile
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.drawn_metadata import draw_inputs
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
