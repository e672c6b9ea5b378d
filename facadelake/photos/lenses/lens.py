"""Which lens and sensor took a photograph, with which digital zoom and in which projection: EXIF, XMP and file name."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from PIL.ExifTags import IFD, Base
from PIL.Image import Exif

from facadelake.photos.drone_xmp import CAMERA_SCHEMAS, DJI
from facadelake.photos.xmp import XmpPacket

GPANO = "http://ns.google.com/photos/1.0/panorama"
FLIR_SCHEMAS = ("http://ns.flir.com/xmp/1.0", "http://ns.flir.com/xmp/1.0/")
# Names of DJI's cameras with several lenses end in _W (wide), _Z (zoom), _T or _THRM (thermal), _V (visible), _S
# (screen); bands of the multispectral cameras in _MS_NIR and the like. Autel's thermal camera writes IRX_0001.
_SOURCE_OF_SUFFIX = {
    "W": "wide", "Z": "zoom", "T": "thermal", "THRM": "thermal", "IR": "thermal", "V": "visible", "S": "screen"
}  # fmt: skip
_SUFFIX = re.compile(r"_(W|Z|T|THRM|IR|V|S)(?:_[^_]+)?$", re.IGNORECASE)
_BAND_SUFFIX = re.compile(r"_MS_(G|R|RE|NIR|B)$", re.IGNORECASE)
_THERMAL_PREFIX = re.compile(r"IRX?_\d+$", re.IGNORECASE)
_BAND_LIST = re.compile(rb"<Camera:BandName>(.*?)</Camera:BandName>", re.DOTALL)
_LIST_ITEM = re.compile(rb"<rdf:li[^>]*>([^<]+)</rdf:li>")
_THERMAL_WORDS = ("infrared", "thermal", "lwir")
_PANCHROMATIC = ("rgb", "panchromatic", "pan")


@dataclass(frozen=True, kw_only=True)
class LensMetadata:
    """What a photograph says of its lens.

    ``image_source`` is ``wide``, ``zoom``, ``thermal``, ``visible`` or ``screen`` of a body with several lenses, empty
    where nothing is said; ``evidence`` names the tag or file name that says so. ``digital_zooms`` are the factors that
    the tags state, by tag; ``digital_zoom`` is the largest of them, 1 where there is none. ``projection`` is
    GPano's ProjectionType, ``band`` the spectral band of a camera with one sensor a band.
    """

    image_source: str = ""
    evidence: str = ""
    digital_zooms: tuple[tuple[str, float], ...] = ()
    projection: str = ""
    band: str = ""

    @property
    def digital_zoom(self) -> float:
        """The digital zoom, 1 for none."""
        return max((factor for _, factor in self.digital_zooms), default=1.0)


NOTHING_SAID = LensMetadata()


def read_lens(exif: Exif, packet: XmpPacket | None, xmp: bytes, file_name: str) -> LensMetadata:
    """What the metadata and the name of a photograph say of its lens; a damaged block says nothing.

    Args:
        exif: the EXIF block.
        packet: the XMP packet, parsed; None where there is none.
        xmp: the same as bytes, for the list of spectral bands.
        file_name: name of the file.
    """
    stem = file_name.rpartition("/")[2].rpartition(".")[0]
    make = str(exif.get(Base.Make) or "").upper()
    source, evidence, projection, band = "", "", "", ""
    zooms = [("EXIF DigitalZoomRatio", _read_exif_zoom(exif))]
    if packet is not None:
        source, evidence = _read_image_source(packet.get_text(DJI, "ImageSource"))
        for name in ("DigitalZoomRatio", "CropFactor"):
            zooms.append((f"XMP {name}", packet.get_number(DJI, name)))
        projection = packet.get_text(GPANO, "ProjectionType")
        band = next((packet.get_text(schema, "BandName") for schema in CAMERA_SCHEMAS), "")
        band = band or packet.get_text(DJI, "BandName")
        if not source and any(packet.has_namespace(schema) for schema in FLIR_SCHEMAS):
            source, evidence = "thermal", "XMP of FLIR"
    listed = _BAND_LIST.search(xmp)
    if not band and listed:
        bands = [item.decode("utf-8", "replace").strip() for item in _LIST_ITEM.findall(listed[1])]
        band = bands[0] if len(bands) == 1 else ""
    band = "" if band.lower() in _PANCHROMATIC else band
    if band.lower() in _THERMAL_WORDS:
        source, evidence, band = "thermal", f"XMP BandName {band}", ""
    by_name = _BAND_SUFFIX.search(stem)
    if not band and by_name and "DJI" in make:
        band = by_name[1].upper()
    if not source:
        source, evidence = _read_source_of_name(stem, make)
    return LensMetadata(
        image_source=source,
        evidence=evidence,
        digital_zooms=tuple((tag, factor) for tag, factor in zooms if factor > 1.0 and math.isfinite(factor)),
        projection=projection,
        band=band,
    )


def _read_exif_zoom(exif: Exif) -> float:
    """DigitalZoomRatio; 0 means not used, and becomes 1."""
    try:
        return float(exif.get_ifd(IFD.Exif).get(Base.DigitalZoomRatio) or 1.0)
    except (OSError, SyntaxError, ValueError, KeyError, TypeError, ZeroDivisionError):
        return 1.0


def _read_image_source(text: str) -> tuple[str, str]:
    """The lens that DJI's ImageSource names (WideCamera, ZoomCamera, InfraredCamera, VisibleCamera), and the tag."""
    lowered = text.lower()
    for word in _THERMAL_WORDS:
        if word in lowered:
            return "thermal", f"XMP ImageSource {text}"
    return lowered.removesuffix("camera"), f"XMP ImageSource {text}" if text else ""


def _read_source_of_name(stem: str, make: str) -> tuple[str, str]:
    """The lens that the file name of a DJI or Autel photograph names."""
    if "AUTEL" in make and _THERMAL_PREFIX.match(stem):
        return "thermal", f"file name {stem}"
    found = _SUFFIX.search(stem)
    if found is None or "DJI" not in make:
        return "", ""
    return _SOURCE_OF_SUFFIX[found[1].upper()], f"file name ending in _{found[1]}"
