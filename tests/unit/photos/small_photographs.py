"""Small JPEGs with the metadata a test asks for."""

import io

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from benchmarks.exif_bytes import Tags, build_exif

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {}/></rdf:RDF></x:xmpmeta>'
)


def dms(value: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees as EXIF writes them."""
    value = abs(value)
    minutes = (value % 1) * 60
    return IFDRational(int(value), 1), IFDRational(int(minutes), 1), IFDRational(round((minutes % 1) * 60e5), 100000)


def photograph(
    lat: float | None = None,
    lon: float = 8.4,
    xmp: str = "",
    seed: int = 0,
    taken: str = "2026:04:14 10:00:05",
    altitude_m: float = 180.5,
) -> bytes:
    """A small JPEG with EXIF, optional GPS and XMP; ``taken`` as EXIF writes it."""
    rng = np.random.default_rng(seed)
    image = Image.fromarray(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    exif = Image.Exif()
    exif[271], exif[272] = "Maker", "Model\0\0"
    exif.get_ifd(0x8769)[36867] = taken
    exif.get_ifd(0x8769)[36881] = "+02:00"
    exif.get_ifd(0x8769)[37386] = IFDRational(5, 1)
    exif.get_ifd(0x8769)[41989] = 26
    if lat is not None:
        block = exif.get_ifd(0x8825)
        block[1], block[2] = "S" if lat < 0 else "N", dms(lat)
        block[3], block[4] = "W" if lon < 0 else "E", dms(lon)
        block[5], block[6] = b"\0", IFDRational(round(altitude_m * 10), 10)
    out = io.BytesIO()
    image.save(out, "JPEG", quality=95, exif=exif, xmp=XMP.format(xmp).encode() if xmp else None)
    return out.getvalue()


def photograph_with(gps: Tags, *, xmp: bytes = b"", detail: Tags | None = None, head: Tags | None = None) -> bytes:
    """A small JPEG with these tags as they are, and this XMP packet as it is."""
    exif = build_exif(
        head={271: "Maker", 272: "Model"} | dict(head or {}),
        detail={36867: "2026:04:14 10:00:05"} if detail is None else detail,
        gps=gps,
    )
    out = io.BytesIO()
    pixels = np.random.default_rng(len(xmp) + len(repr(gps))).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(out, "JPEG", exif=exif, xmp=xmp or None)
    return out.getvalue()
