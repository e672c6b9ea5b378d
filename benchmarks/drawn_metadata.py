"""Small JPEGs with a GPS block and a packet of DJI's XMP in many forms, some of them damaged."""

from __future__ import annotations

import io
import struct

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from PIL import Image

from benchmarks.exif_bytes import DOUBLE, SHORT, ExifEntry, Value, build_exif, encode_ratios


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
