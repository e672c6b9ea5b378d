"""Thermal pictures, panoramas, bands and companion lenses are told apart, and the rest is used."""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from facadelake.photos.exif import ExifMetadata
from facadelake.photos.ingest import ingest_photographs
from facadelake.photos.lenses.lens import LensMetadata, read_lens
from facadelake.photos.picture_kinds import find_kept_out
from facadelake.photos.priors import PhotoMetadata
from facadelake.photos.xmp import parse_packet
from schemas.vocabulary import PhotoOutcome
from tests.unit.photos.small_photographs import XMP, photograph

START = datetime(2026, 4, 14, 10, 0, tzinfo=UTC)


def photo(
    name: str = "DJI_0001.JPG",
    *,
    size: tuple[int, int] = (4000, 3000),
    make: str = "DJI",
    model: str = "M3T",
    xmp: str = "",
    second: float = 0.0,
) -> PhotoMetadata:
    exif = Image.Exif()
    exif[271], exif[272] = make, model
    return PhotoMetadata(
        photo_id=name,
        width_px=size[0],
        height_px=size[1],
        exif=ExifMetadata(make=make, model=model, body_serial="S1", taken_at=START + timedelta(seconds=second)),
        drone=None,
        lens=read_lens(exif, parse_packet(xmp.encode()), xmp.encode(), name),
    )


def dji(attributes: str) -> str:
    return XMP.format(attributes)


GPANO = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="equirectangular"/>'
    "</rdf:RDF></x:xmpmeta>"
)
BAND = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:Camera="http://pix4d.com/camera/1.0/"><Camera:BandName><rdf:Seq>{}</rdf:Seq>'
    "</Camera:BandName></rdf:Description></rdf:RDF></x:xmpmeta>"
)
VISIBLE = photo("a.jpg")


@pytest.mark.parametrize(
    ("found", "outcome", "evidence"),
    [
        (photo(xmp=dji('drone-dji:ImageSource="InfraredCamera"')), "thermal", "XMP ImageSource InfraredCamera"),
        (photo("DJI_20260414100005_0007_T.JPG", size=(640, 512)), "thermal", "file name ending in _T"),
        (photo("DJI_0004_THRM.JPG", size=(640, 512)), "thermal", "file name ending in _THRM"),
        (photo(make="FLIR Systems AB", model="FLIR E8"), "thermal", "EXIF Make FLIR Systems AB"),
        (photo(model="Zenmuse XT2", size=(640, 512)), "thermal", "EXIF Model Zenmuse XT2, 640 x 512 px"),
        (photo(make="X", model="Y", size=(640, 512)), "thermal", "the size of a thermal sensor"),
        (photo(make="Autel Robotics", model="XL715", name="IRX_0012.jpg"), "thermal", "file name IRX_0012"),
        (photo(xmp=BAND.format("<rdf:li>LWIR</rdf:li>")), "thermal", "XMP BandName LWIR"),
        (photo(xmp=BAND.format("<rdf:li>NIR</rdf:li>")), "spectral_band", "NIR"),
        (photo("DJI_20260414_0007_MS_RE.TIF"), "spectral_band", "RE"),
        (photo(xmp=GPANO), "panorama", "XMP GPano ProjectionType equirectangular"),
        (photo(size=(9000, 2500)), "panorama", "9000 x 2500 px"),
        (photo(size=(2500, 9000)), "panorama", "2500 x 9000 px"),
        (photo(make="RICOH", model="RICOH THETA Z1", size=(6720, 3360)), "panorama", "the 2 : 1 of a sphere"),
    ],
)
def test_pictures_that_are_no_photographs_of_the_block(found: PhotoMetadata, outcome: str, evidence: str) -> None:
    kept_out = find_kept_out([found, VISIBLE])
    assert list(kept_out) == [found.photo_id]
    assert kept_out[found.photo_id].outcome == outcome
    assert evidence in kept_out[found.photo_id].reason
    assert f"'use_photographs: [{outcome}]' in the portfolio uses it" in kept_out[found.photo_id].reason
    assert find_kept_out([found, VISIBLE], [PhotoOutcome(outcome)]) == {}


@pytest.mark.parametrize(
    "found",
    [
        photo(),
        photo(xmp=BAND.format("<rdf:li>Red</rdf:li><rdf:li>Green</rdf:li><rdf:li>Blue</rdf:li>")),
        photo(size=(4032, 1816), make="Samsung", model="S20"),  # 20:9, the widest of phones
        photo(size=(4608, 2304), make="Xiaomi", model="Mi A2"),  # 2:1 and no sphere
        photo("HALL_T.JPG", make="Canon", model="EOS R5"),
        photo("DJI_0001_Z.JPG", xmp=dji('drone-dji:ImageSource="ZoomCamera"')),  # alone: a viewpoint of its own
        photo(model="XT2", size=(4000, 3000)),
    ],
)
def test_photographs_stay(found: PhotoMetadata) -> None:
    assert find_kept_out([found, photo("other.jpg", second=60)]) == {}


def test_of_lenses_that_fire_together_the_widest_is_used() -> None:
    shots = [
        photo(f"DJI_2026041410000{k}_000{k}_{lens}.JPG", second=4.0 * k + delay)
        for k in range(4)
        for lens, delay in (("W", 0.0), ("Z", 0.8), ("T", 0.3))
    ]
    kept_out = find_kept_out(shots)
    assert {name: one.outcome for name, one in kept_out.items()} == {
        one.photo_id: "thermal" if "_T." in one.photo_id else "other_lens" for one in shots if "_W." not in one.photo_id
    }
    assert "together with DJI_20260414100002_0002_W.JPG" in kept_out["DJI_20260414100002_0002_Z.JPG"].reason
    assert set(find_kept_out(shots, [PhotoOutcome.OTHER_LENS])) == {s.photo_id for s in shots if "_T." in s.photo_id}


def test_digital_zoom_of_exif_and_xmp() -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA404] = IFDRational(15, 10)
    assert read_lens(exif, None, b"", "a.jpg").digital_zoom == 1.5
    crop = dji('drone-dji:CropFactor="2.0"').encode()
    assert read_lens(exif, parse_packet(crop), crop, "a.jpg").digital_zooms == (
        ("EXIF DigitalZoomRatio", 1.5),
        ("XMP CropFactor", 2.0),
    )
    exif.get_ifd(0x8769)[0xA404] = IFDRational(0, 1)  # not used
    assert read_lens(exif, None, b"", "a.jpg") == LensMetadata()


def thermal(seed: int, taken: str) -> bytes:
    """A small thermal picture with DJI's tags, 6 m lower than the photographs."""
    rng = np.random.default_rng(seed)
    exif = Image.Exif()
    exif[271], exif[272] = "Maker", "Model"
    exif.get_ifd(0x8769)[36867], exif.get_ifd(0x8769)[36881] = taken, "+02:00"
    out = io.BytesIO()
    xmp = XMP.format(
        'drone-dji:ImageSource="InfraredCamera" drone-dji:AbsoluteAltitude="+194.5" drone-dji:RelativeAltitude="+20.0"'
    )
    Image.fromarray(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)).save(out, "JPEG", exif=exif, xmp=xmp.encode())
    return out.getvalue()


def test_a_pair_of_wide_and_thermal_is_one_flight_with_a_reason_for_each_thermal(tmp_path: Path) -> None:
    for k in range(9):
        taken = f"2026:04:14 10:00:{5 * k:02d}"
        xmp = 'drone-dji:AbsoluteAltitude="+200.5" drone-dji:RelativeAltitude="+20.0"'
        (tmp_path / f"DJI_{k:04d}_W.JPG").write_bytes(photograph(49.0 + k * 1e-5, xmp=xmp, seed=k, taken=taken))
        (tmp_path / f"DJI_{k:04d}_T.JPG").write_bytes(thermal(100 + k, taken))
    rows = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    assert [row["photo_outcome"] for row in rows] == ["thermal", "accepted"] * 9
    assert [row["flight"] for row in rows] == [1] * 18
    assert rows[0]["image_source"] == "thermal"
    assert rows[0]["image_width_px"] == 64
    assert rows[0]["reason"].startswith("a thermal picture (XMP ImageSource InfraredCamera); it is kept out")
    used = ingest_photographs(
        tmp_path, distance_to_model_m=None, close_range_below_m=8.0, used_kinds=[PhotoOutcome.THERMAL]
    ).to_pylist()
    assert [row["photo_outcome"] for row in used] == ["accepted"] * 18
    assert [row["flight"] for row in used] == [1] * 18
