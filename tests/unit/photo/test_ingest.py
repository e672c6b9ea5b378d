"""Ingest: outcomes and reasons of good and bad files."""

import io
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from facadelake.errors import InputDataError
from facadelake.photo.files import find_photographs
from facadelake.photo.ingest import ingest_photographs

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {}/></rdf:RDF></x:xmpmeta>'
)


def dms(value: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees as EXIF writes them."""
    value = abs(value)
    minutes = (value % 1) * 60
    return IFDRational(int(value), 1), IFDRational(int(minutes), 1), IFDRational(round((minutes % 1) * 60e5), 100000)


def photograph(lat: float | None = None, lon: float = 8.4, xmp: str = "", seed: int = 0, **gps: object) -> bytes:
    """A small JPEG with EXIF, optional GPS and XMP."""
    rng = np.random.default_rng(seed)
    image = Image.fromarray(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    exif = Image.Exif()
    exif[271], exif[272] = "Maker", "Model\0\0"
    exif.get_ifd(0x8769)[36867] = "2026:04:14 10:00:05"
    exif.get_ifd(0x8769)[36881] = "+02:00"
    exif.get_ifd(0x8769)[37386] = IFDRational(5, 1)
    exif.get_ifd(0x8769)[41989] = 26
    if lat is not None:
        block = exif.get_ifd(0x8825)
        block[1], block[2] = "S" if lat < 0 else "N", dms(lat)
        block[3], block[4] = "W" if lon < 0 else "E", dms(lon)
        block[5], block[6] = b"\0", IFDRational(1805, 10)
    out = io.BytesIO()
    image.save(out, "JPEG", quality=95, exif=exif, xmp=XMP.format(xmp).encode() if xmp else None)
    return out.getvalue()


def ingest(root: Path, **changed: object) -> dict[str, dict[str, object]]:
    """Rows by photo_id."""
    table = ingest_photographs(root, distance_to_model_m=changed.get("distance"), close_range_below_m=10.0)  # type: ignore[arg-type]
    return {row["photo_id"]: row for row in table.to_pylist()}


def test_a_good_photograph_says_what_its_exif_says(tmp_path: Path) -> None:
    (tmp_path / "a.JPG").write_bytes(photograph(lat=-48.94, lon=-8.4))
    row = ingest(tmp_path)["a.JPG"]
    assert (row["photo_outcome"], row["reason"]) == ("accepted", None)
    assert (row["camera_make"], row["camera_model"], row["image_width_px"], row["image_height_px"]) == (
        "Maker", "Model", 64, 48,
    )  # fmt: skip
    assert row["taken_at"] == datetime(2026, 4, 14, 8, 0, 5, tzinfo=UTC)
    np.testing.assert_allclose([row["prior_lat_deg"], row["prior_lon_deg"]], [-48.94, -8.4], rtol=0, atol=1e-8)  # deg
    assert (row["prior_source"], row["prior_height_m"], row["prior_height_datum"]) == ("exif", 180.5, "unknown")
    assert (row["focal_length_mm"], row["focal_length_35mm_mm"]) == (5.0, 26.0)
    assert row["role"] == "multiview"


def test_bad_files_are_rows_with_their_reason(tmp_path: Path) -> None:
    good = photograph(lat=48.94, seed=1)
    (tmp_path / "good.jpg").write_bytes(good)
    (tmp_path / "truncated.jpg").write_bytes(photograph(lat=48.94, seed=2)[:-400])
    (tmp_path / "zero.jpg").write_bytes(b"")
    (tmp_path / "text.jpg").write_bytes(b"this is no photograph")
    (tmp_path / "twin.jpg").write_bytes(good)
    (tmp_path / "raw.DNG").write_bytes(b"II*\0")
    Image.new("RGB", (8, 8)).save(tmp_path / "png.JPG", format="PNG")
    rows = ingest(tmp_path)
    expected = {
        "good.jpg": ("accepted", None),
        "truncated.jpg": ("unreadable", "does not decode to its end (image file is truncated"),
        "zero.jpg": ("unreadable", "the file is empty (0 bytes)"),
        "text.jpg": ("unreadable", "no image format is recognised"),
        "twin.jpg": ("duplicate", "the same bytes as good.jpg"),
        "raw.DNG": ("unreadable", "raw photograph: it must be developed first"),
        "png.JPG": ("unreadable", "the name ends in .JPG but the content is PNG"),
    }
    assert rows.keys() == expected.keys()
    for photo_id, (outcome, reason) in expected.items():
        assert rows[photo_id]["photo_outcome"] == outcome, photo_id
        said = rows[photo_id]["reason"]
        assert said is None if reason is None else reason in str(said), (photo_id, said)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (photograph(), "EXIF: no position"),
        (photograph(lat=0.0, lon=0.0), "EXIF: position is 0/0"),
        (photograph(lat=91.0), "EXIF: position lon 8.400000, lat 91.000000 is off the globe"),
        (
            photograph(xmp='drone-dji:GpsLatitude="91.0" drone-dji:GpsLongitude="8.4"'),
            "XMP: position lon 8.400000, lat 91.000000 is off the globe",
        ),
        (photograph(xmp='drone-dji:GpsLatitude="nan" drone-dji:GpsLongitude="8.4"'), "XMP: no position"),
    ],
)
def test_a_photograph_without_a_usable_position_is_accepted_without_prior(
    tmp_path: Path, content: bytes, reason: str
) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    row = ingest(tmp_path)["a.jpg"]
    assert (row["photo_outcome"], row["prior_source"]) == ("accepted", "none")
    assert reason in str(row["reason"])
    assert row["prior_lat_deg"] is None
    assert row["prior_sigma_horizontal_m"] is None


def test_xmp_goes_before_exif_and_a_bad_xmp_position_falls_back(tmp_path: Path) -> None:
    good = 'drone-dji:GpsLatitude="48.95" drone-dji:GpsLongitude="8.45" drone-dji:AbsoluteAltitude="+190.5"'
    (tmp_path / "xmp.jpg").write_bytes(photograph(lat=48.94, xmp=good))
    (tmp_path / "both.jpg").write_bytes(
        photograph(lat=48.94, xmp='drone-dji:GpsLatitude="0" drone-dji:GpsLongitude="0"')
    )
    rows = ingest(tmp_path)
    said = [rows["xmp.jpg"][f"prior_{name}"] for name in ("source", "lat_deg", "lon_deg", "height_m")]
    assert said == ["xmp", 48.95, 8.45, 190.5]
    assert rows["both.jpg"]["prior_source"] == "exif"


def test_roles_come_from_folders_then_from_distance(tmp_path: Path) -> None:
    for name, lat in (("MultiView/a.jpg", 48.0), ("close-range/b.jpg", 49.0), ("c.jpg", 48.0), ("d.jpg", 49.0)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(photograph(lat=lat, seed=ord(name[-5])))
    (tmp_path / "e.jpg").write_bytes(photograph(seed=9))

    def distance(lon_lat_deg: np.ndarray) -> np.ndarray:
        assert lon_lat_deg.shape == (2, 2)  # only those that no folder and no missing position decides
        return np.where(lon_lat_deg[:, 1] > 48.5, 4.0, 40.0)

    roles = {photo_id: row["role"] for photo_id, row in ingest(tmp_path, distance=distance).items()}
    assert roles == {
        "MultiView/a.jpg": "multiview",
        "close-range/b.jpg": "closerange",
        "c.jpg": "multiview",
        "d.jpg": "closerange",
        "e.jpg": "multiview",
    }


def test_hidden_and_foreign_files_are_not_photographs(tmp_path: Path) -> None:
    for name in (".hidden/a.jpg", "b.txt", "._c.jpg", "sub/d.TIFF", "e.Jpeg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    assert [path.name for path in find_photographs(tmp_path)] == ["e.Jpeg", "d.TIFF"]


def test_nothing_usable_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="does not exist"):
        ingest(tmp_path / "nowhere")
    with pytest.raises(InputDataError, match="no photograph in"):
        ingest(tmp_path)
    (tmp_path / "a.jpg").write_bytes(b"")
    with pytest.raises(InputDataError, match=r"none of the 1 photographs .* a.jpg: the file is empty"):
        ingest(tmp_path)
