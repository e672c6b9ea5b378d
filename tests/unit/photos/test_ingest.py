"""Rows of readable files; unreadable ones are in tests/counterexamples/test_photographs.py."""

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from PIL import Image

from facadelake.photos.files import FORMATS_BY_SUFFIX, find_photographs
from facadelake.photos.ingest import ingest_photographs
from tests.unit.photos.small_photographs import photograph


def ingest(root: Path, **changed: object) -> dict[str, dict[str, object]]:
    """Rows by photo_id."""
    table = ingest_photographs(root, distance_to_model_m=changed.get("distance"), close_range_below_m=10.0)  # type: ignore[arg-type]
    return {row["photo_id"]: row for row in table.to_pylist()}


def test_the_row_of_a_photograph_has_the_values_of_its_exif(tmp_path: Path) -> None:
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


def test_xmp_goes_before_exif_and_a_bad_xmp_position_falls_back(tmp_path: Path) -> None:
    good = 'drone-dji:GpsLatitude="48.95" drone-dji:GpsLongitude="8.45" drone-dji:AbsoluteAltitude="+190.5"'
    (tmp_path / "xmp.jpg").write_bytes(photograph(lat=48.94, xmp=good))
    (tmp_path / "both.jpg").write_bytes(
        photograph(lat=48.94, xmp='drone-dji:GpsLatitude="0" drone-dji:GpsLongitude="0"')
    )
    rows = ingest(tmp_path)
    values = [rows["xmp.jpg"][f"prior_{name}"] for name in ("source", "lat_deg", "lon_deg", "height_m")]
    assert values == ["xmp", 48.95, 8.45, 190.5]
    assert rows["both.jpg"]["prior_source"] == "exif"


def test_roles_come_from_folders_then_from_distance(tmp_path: Path) -> None:
    for name, lat in (("MultiView/a.jpg", 48.0), ("close-range/b.jpg", 49.0), ("c.jpg", 48.0), ("d.jpg", 49.0)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(photograph(lat=lat, seed=ord(name[-5])))
    (tmp_path / "e.jpg").write_bytes(photograph(seed=9))

    def distance(lon_lat_deg: np.ndarray) -> np.ndarray:
        assert len(lon_lat_deg) in (2, 4)  # the two that no folder decides; all with a position where they are checked
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
    # what macOS writes beside photographs is listed, to be refused with a reason
    assert [path.name for path in find_photographs(tmp_path)] == ["._c.jpg", "e.Jpeg", "d.TIFF"]


def test_colmap_and_opencv_decode_every_format_that_is_accepted(tmp_path: Path) -> None:
    """In a process of its own, as COLMAP's worker is."""
    pixels = Image.fromarray(np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8))
    for suffix, formats in FORMATS_BY_SUFFIX.items():
        for name in formats:
            pixels.save(tmp_path / f"{name}{suffix}", format=name)
    for compression in ("tiff_lzw", "tiff_adobe_deflate", "jpeg"):
        pixels.save(tmp_path / f"{compression}.tif", compression=compression)
    code = (
        "import sys, cv2, pycolmap\n"
        "for path in sys.argv[1:]:\n"
        "    assert pycolmap.Bitmap.read(path, False) is not None, path\n"
        "    assert cv2.imread(path) is not None, path\n"
    )
    paths = sorted(map(str, tmp_path.iterdir()))
    assert len(paths) == 14
    subprocess.run([sys.executable, "-c", code, *paths], check=True)


def test_the_photographs_of_one_camera_decide_its_pitch_convention(tmp_path: Path) -> None:
    """Autel's XL715: horizontal and downward view, in DJI's convention under Pix4D's name."""
    for name, pitch in (("level.jpg", "0.0"), ("down.jpg", "-30.0")):
        xmp = f'xmlns:Camera="http://pix4d.com/camera/1.0" Camera:Yaw="10" Camera:Pitch="{pitch}" Camera:Roll="0.5"'
        (tmp_path / name).write_bytes(photograph(lat=48.94, xmp=xmp, seed=len(name)))
    rows = ingest(tmp_path)
    assert (rows["level.jpg"]["prior_pitch_deg"], rows["down.jpg"]["prior_pitch_deg"]) == (0.0, -30.0)
    (tmp_path / "down.jpg").unlink()
    assert ingest(tmp_path)["level.jpg"]["prior_pitch_deg"] == -90.0  # alone: Pix4D's convention


def test_a_duplicate_has_the_priors_of_its_original_and_takes_no_part_in_checks(tmp_path: Path) -> None:
    for k in range(4):
        (tmp_path / f"{k}.jpg").write_bytes(photograph(lat=48.94001, seed=0, taken="2026:04:14 10:00:05"))
    rows = ingest(tmp_path)
    assert [row["photo_outcome"] for row in rows.values()] == ["accepted", *["duplicate"] * 3]
    assert {(row["prior_source"], row["flight"], row["prior_warnings"]) for row in rows.values()} == {("exif", 1, None)}
