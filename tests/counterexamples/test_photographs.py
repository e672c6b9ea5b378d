"""Bad photographs among good ones, each with the words it must give; and folders that give nothing to work with."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.detection.coco.import_detections import import_coco
from facadelake.photos.ingest import ingest_photographs
from facadelake.sfm.reconstruction import LocalisedPhoto, Reconstruction
from facadelake.sfm.reconstruction_job import reconstruct
from facadelake.sfm.settings import ReconstructionSettings
from tests.unit.photos.small_photographs import photograph

LAT = 48.94  # deg, where the good ones stand
XMP_91 = 'drone-dji:GpsLatitude="91.0" drone-dji:GpsLongitude="8.4"'
INVALID = 'drone-dji:GpsStatus="Invalid" drone-dji:GpsLatitude="48.9" drone-dji:GpsLongitude="8.4"'
NO_PRIOR = "the photograph is used without one"

REFUSED = {
    "text.jpg": "the file has no known image format; copy it again from the card",
    "truncated.jpg": "the photograph cannot be decoded completely (image file is truncated (… bytes not processed)); "
    "copy it again from the card",
    "header-alone.jpg": "the photograph cannot be decoded completely (Truncated File Read); "
    "copy it again from the card",
    "zero.jpg": "the file is empty (0 bytes); copy it again from the camera's card",
    "png.JPG": "the name ends in .JPG but the content is PNG; such files come from a conversion that often loses "
    "metadata: export the original again, or correct the suffix",
    "raw.DNG": "raw photographs are not supported; export this one as JPEG or TIFF",
}
CONVERT_HEIC = (
    "HEIC and AVIF photographs are not supported; convert this one to JPEG with its EXIF (heif-convert -q 95), and set "
    "the camera to JPEG"
)
RAW = "raw photographs are not supported; export this one as JPEG or TIFF"
NOT_READ = {
    "a.HEIC": CONVERT_HEIC,
    "b.heif": CONVERT_HEIC,
    "c.CR2": RAW,
    "d.arw": RAW,
    "e.NEF": RAW,
    "f.webp": "WebP photographs are not supported: COLMAP, which reconstructs the block, does not decode them; use the "
    "camera's original, or convert this one to JPEG with its EXIF and XMP",
    "g.gif": "pictures of this format are not supported; use the camera's original, or convert this one to JPEG",
    "h.MP4": "a video is no photograph; extract frames as JPEG, and give their positions in a file (key 'positions')",
    "._good.jpg": "a file that macOS writes beside good.jpg for its own metadata; it has no picture: delete it",
    "good.jpg_original": "a backup copy that exiftool wrote of good.jpg; delete it, or move it out of the photographs' "
    "folder",
    "i": "the content is that of a picture but the name has no suffix; rename it, such as to i.jpg",
}
WITHOUT_PRIOR = {
    "no-exif.jpg": f"no position prior (EXIF: no position); {NO_PRIOR}",
    "no-gps.jpg": f"no position prior (EXIF: no position); {NO_PRIOR}",
    "zero-zero.jpg": "no position prior (EXIF: position is 0/0, which receivers write without a fix); "
    "the photograph is used without one",
    "lat-91.jpg": "no position prior (EXIF: position lon 8.400000, lat 91.000000 is out of range "
    "(lon -180..180, lat -90..90)); the photograph is used without one",
    "xmp-91.jpg": "no position prior (XMP: position lon 8.400000, lat 91.000000 is out of range "
    "(lon -180..180, lat -90..90); EXIF: no position); the photograph is used without one",
    "invalid.jpg": f"no position prior (XMP: GpsStatus is Invalid; EXIF: no position); {NO_PRIOR}",
    "xmp-nan.jpg": f"no position prior (XMP: no position; EXIF: no position); {NO_PRIOR}",
}
GOOD = ("good-1.jpg", "good-2.jpg", "good-3.jpg")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three good photographs and every kind of bad one."""
    root = tmp_path_factory.mktemp("photographs")
    for seed, name in enumerate(GOOD):
        (root / name).write_bytes(photograph(lat=LAT, seed=seed))
    (root / "twin-of-1.jpg").write_bytes((root / GOOD[0]).read_bytes())
    (root / "text.jpg").write_bytes(b"this is no photograph")
    (root / "truncated.jpg").write_bytes(photograph(lat=LAT, seed=10)[:-400])
    (root / "header-alone.jpg").write_bytes(photograph(lat=LAT, seed=11)[:300])
    (root / "zero.jpg").write_bytes(b"")
    Image.new("RGB", (8, 8)).save(root / "png.JPG", format="PNG")
    (root / "raw.DNG").write_bytes(b"II*\0")
    Image.new("RGB", (64, 48), (90, 80, 70)).save(root / "no-exif.jpg", format="JPEG")
    (root / "no-gps.jpg").write_bytes(photograph(seed=12))
    (root / "zero-zero.jpg").write_bytes(photograph(lat=0.0, lon=0.0, seed=13))
    (root / "lat-91.jpg").write_bytes(photograph(lat=91.0, seed=14))
    (root / "xmp-91.jpg").write_bytes(photograph(xmp=XMP_91, seed=15))
    (root / "xmp-nan.jpg").write_bytes(photograph(xmp=XMP_91.replace("91.0", "nan"), seed=16))
    (root / "invalid.jpg").write_bytes(photograph(xmp=INVALID, seed=17))
    return root


@pytest.fixture(scope="module")
def photos(folder: Path) -> pa.Table:
    return ingest_photographs(folder, distance_to_model_m=None, close_range_below_m=8.0)


def test_every_bad_file_is_a_row_and_the_good_ones_go_on(photos: pa.Table) -> None:
    rows = {row["photo_id"]: row for row in photos.to_pylist()}
    found = {
        photo_id: (row["photo_outcome"], re.sub(r"\d+(?= bytes not)", "…", row["reason"] or ""))
        for photo_id, row in rows.items()
    }
    assert found == {
        **dict.fromkeys(GOOD, ("accepted", "")),
        **{name: ("unreadable", reason) for name, reason in REFUSED.items()},
        **{name: ("accepted", reason) for name, reason in WITHOUT_PRIOR.items()},
        "twin-of-1.jpg": ("duplicate", "same content as good-1.jpg; remove one of the two"),
    }
    assert [rows[name]["prior_source"] for name in GOOD] == ["exif"] * 3
    for name in WITHOUT_PRIOR:
        assert (rows[name]["prior_source"], rows[name]["prior_height_datum"]) == ("none", "unknown")
        said = ("lon_deg", "lat_deg", "height_m", "sigma_horizontal_m", "sigma_vertical_m", "evidence")
        assert {rows[name][f"prior_{column}"] for column in said} == {None}, name


def test_what_looks_like_a_photograph_and_is_not_read_has_a_row_and_a_reason(tmp_path: Path) -> None:
    for name in NOT_READ:
        (tmp_path / name).write_bytes(photograph(lat=LAT, seed=30) if name in ("i", "good.jpg_original") else b"x")
    (tmp_path / "good.jpg").write_bytes(photograph(lat=LAT, seed=31))
    (tmp_path / "good.jfif").write_bytes(photograph(lat=LAT, seed=32))
    for name in ("notes.txt", "noname", ".DS_Store", "Thumbs.db", "track.gpx"):
        (tmp_path / name).write_bytes(b"x")
    rows = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    assert {row["photo_id"]: row["reason"] for row in rows if row["photo_outcome"] == "unreadable"} == NOT_READ
    assert [row["photo_id"] for row in rows if row["photo_outcome"] == "accepted"] == ["good.jfif", "good.jpg"]


def test_a_position_out_of_range_in_xmp_leaves_that_of_exif(tmp_path: Path) -> None:
    (tmp_path / "both.jpg").write_bytes(photograph(lat=LAT, xmp=XMP_91))
    (row,) = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    assert (row["photo_outcome"], row["reason"], row["prior_source"]) == ("accepted", None, "exif")
    assert row["prior_lat_deg"] == pytest.approx(LAT, rel=0, abs=1e-8)  # deg


# One flight, a photograph every 5 m and 2 s; what those get that have something wrong with them.
DROPPED = {
    "DJI_0002.jpg": "the position is … km from the other photographs; with latitude and longitude swapped it would be "
    "… m away: correct the metadata",
    "DJI_0003.jpg": "the position is … km from the other photographs; with the sign of the longitude (E/W) changed it "
    "would be … m away: correct the metadata",
    "DJI_0004.jpg": "the position is … m from that of the photograph … s before, faster than 30 m/s; the positions "
    "before and after are consistent",
}
WARNED = {
    "DJI_0005.jpg": "height 12000 m is out of range (-500 to 9000 m); not used",
    "DJI_0006.jpg": "height 655.0 m is inconsistent with those before and after; not used",
    "DJI_0008.jpg": "the time contradicts the order of the file names: the clock was changed, or files were renamed",
    "DJI_0010.jpg": "taken at 1980-01-06: the camera's clock was not set; the time is not used",
}


def flight_with_slips(root: Path) -> None:
    """Photographs DJI_0001 to DJI_0012."""
    for k in range(1, 13):
        said = {"lat": LAT, "lon": 8.4 + k * 5 / 73_000, "taken": f"2026:04:14 10:00:{2 * k:02d}"}
        said |= {
            2: {"lat": 8.4, "lon": LAT},
            3: {"lon": -8.4},
            4: {"lat": LAT + 0.01},
            5: {"altitude_m": 12000.0},
            6: {"altitude_m": 655.0},
            8: {"taken": "2026:04:14 10:00:01"},
            10: {"taken": "1980:01:06 12:00:10"},
        }.get(k, {})
        (root / f"DJI_{k:04d}.jpg").write_bytes(photograph(seed=k, **said))  # type: ignore[arg-type]


def test_what_only_the_other_photographs_show_to_be_wrong(tmp_path: Path) -> None:
    flight_with_slips(tmp_path)
    table = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0)
    rows = {row["photo_id"]: row for row in table.to_pylist()}

    def plain(text: str | None) -> str:
        return re.sub(r"\d+(?= (km from|m from|m away|s before))", "…", text or "")

    assert set(table.column("photo_outcome").to_pylist()) == {"accepted"}
    assert {
        name: plain(row["prior_warnings"]) for name, row in rows.items() if row["prior_warnings"]
    } == DROPPED | WARNED
    assert [name for name, row in rows.items() if row["taken_at"] is None] == ["DJI_0010.jpg"]
    assert {name: plain(row["reason"]) for name, row in rows.items() if row["prior_source"] == "none"} == {
        name: f"no position prior ({reason}); {NO_PRIOR}" for name, reason in DROPPED.items()
    }
    assert [name for name, row in rows.items() if row["prior_source"] == "exif" and row["prior_height_m"] is None] == [
        "DJI_0005.jpg",
        "DJI_0006.jpg",
    ]


def test_a_receiver_that_froze(tmp_path: Path) -> None:
    for k in range(8):
        lon = 8.4 + max(0, k - 3) * 50 / 73_000
        (tmp_path / f"{k}.jpg").write_bytes(photograph(lat=LAT, lon=lon, seed=k, taken=f"2026:04:14 10:00:{5 * k:02d}"))
    rows = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    assert [row["prior_warnings"] for row in rows] == ["4 consecutive photographs have the same position"] * 4 + [
        None
    ] * 4
    assert [row["prior_sigma_horizontal_m"] for row in rows[3:5]] == pytest.approx([50.0, 5.0], rel=0, abs=0.5)  # m
    frozen = tmp_path / "frozen"
    frozen.mkdir()
    for k in range(4):
        (frozen / f"{k}.jpg").write_bytes(photograph(lat=48.94001, seed=k, taken=f"2026:04:14 10:00:{5 * k:02d}"))
    rows = ingest_photographs(frozen, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    assert {(row["prior_source"], row["prior_warnings"]) for row in rows} == {
        ("none", "all 4 photographs have the same position: it was not measured, or is truncated")
    }


def test_boxes_on_a_refused_photograph_are_rows_and_the_others_go_on(tmp_path: Path, photos: pa.Table) -> None:
    names = ["good-1.jpg", "truncated.jpg", "twin-of-1.jpg"]
    boxes = tmp_path / "boxes.json"
    boxes.write_text(
        json.dumps(
            {
                "images": [{"id": i, "file_name": name, "width": 64, "height": 48} for i, name in enumerate(names)],
                "categories": [{"id": 1, "name": "crack"}],
                "annotations": [{"id": i, "image_id": i, "category_id": 1, "bbox": [1, 2, 3, 4]} for i in range(3)],
            }
        )
    )
    found = import_coco(boxes, photos, class_names={}).to_pylist()
    assert [(row["detection_outcome"], row["reason"]) for row in found] == [
        ("accepted", None),
        ("unknown_photo", "the photograph was not accepted: unreadable"),
        ("unknown_photo", "the photograph was not accepted: duplicate"),
    ]


def refusal(root: Path) -> str:
    with pytest.raises(InputDataError) as raised:
        ingest_photographs(root, distance_to_model_m=None, close_range_below_m=8.0)
    return str(raised.value)


def test_a_folder_with_nothing_to_work_with(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    assert refusal(nowhere) == f"the photographs' folder {nowhere} does not exist; check the path in the portfolio"
    (tmp_path / "readme.txt").write_text("no photograph")
    assert refusal(tmp_path) == (
        f"no photograph in {tmp_path} or its sub-folders; photographs are jpg, jpeg, png, tif and tiff files"
    )
    (tmp_path / "a.jpg").write_bytes(b"")
    (tmp_path / "b.jpg").write_bytes(b"")
    assert refusal(tmp_path) == (
        f"none of the 2 photographs in {tmp_path} can be used; the first, a.jpg: "
        "the file is empty (0 bytes); copy it again from the camera's card"
    )


def test_two_usable_photographs_are_too_few(tmp_path: Path) -> None:
    root = tmp_path / "photographs"
    root.mkdir()
    for seed, name in enumerate(GOOD):
        (root / name).write_bytes(photograph(lat=LAT, seed=seed))
    (root / GOOD[2]).write_bytes(b"")
    photos = ingest_photographs(root, distance_to_model_m=None, close_range_below_m=8.0)
    with pytest.raises(InputDataError) as raised:
        reconstruct(photos, root, tmp_path / "block", ReconstructionSettings())
    assert str(raised.value) == ("2 of 3 photographs are usable; at least 3 that overlap are needed: add photographs")


KEPT_OUT = [
    (
        "DJI_0001_T.JPG", "drone-dji:ImageSource=\"InfraredCamera\"", "thermal",
        "a thermal picture (XMP ImageSource InfraredCamera); it is kept out of the block "
        "('use_photographs: [thermal]' in the portfolio uses it)",
    ),
    (
        "pano.jpg", "xmlns:GPano=\"http://ns.google.com/photos/1.0/panorama/\" "
        "GPano:ProjectionType=\"equirectangular\"", "panorama",
        "a panorama, no central projection (XMP GPano ProjectionType equirectangular); it is kept out of the block "
        "('use_photographs: [panorama]' in the portfolio uses it)",
    ),
    (
        "DJI_0001_MS_NIR.JPG", "drone-dji:BandName=\"NIR\"", "spectral_band",
        "a single spectral band (NIR); it is kept out of the block "
        "('use_photographs: [spectral_band]' in the portfolio uses it)",
    ),
    (
        "DJI_0001_Z.JPG", "drone-dji:ImageSource=\"ZoomCamera\"", "other_lens",
        "taken by the zoom lens (XMP ImageSource ZoomCamera) together with DJI_0001_W.JPG of the wide lens, "
        "from the same place; it is kept out of the block "
        "('use_photographs: [other_lens]' in the portfolio uses it)",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "xmp", "outcome", "reason"), KEPT_OUT)
def test_pictures_of_another_kind_are_rows_and_the_others_are_used(
    tmp_path: Path, name: str, xmp: str, outcome: str, reason: str
) -> None:
    (tmp_path / name).write_bytes(photograph(49.0, seed=1, xmp=xmp))
    wide = photograph(49.0, seed=2, xmp='drone-dji:ImageSource="WideCamera"')
    (tmp_path / "DJI_0001_W.JPG").write_bytes(wide)
    rows = {
        row["photo_id"]: row
        for row in ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    }
    assert (rows[name]["photo_outcome"], rows[name]["reason"]) == (outcome, reason)
    assert rows["DJI_0001_W.JPG"]["photo_outcome"] == "accepted"


def test_a_digital_zoom_that_may_be_in_the_focal_length_or_not(tmp_path: Path) -> None:
    image = Image.open(io.BytesIO(photograph(LAT)))
    exif = image.getexif()
    exif.get_ifd(0x8769)[0xA404] = IFDRational(2, 1)
    image.save(tmp_path / "zoomed.jpg", exif=exif)
    (row,) = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0).to_pylist()
    assert row["prior_focal_px"] is None
    assert row["digital_zoom"] == 2.0
    assert row["prior_warnings"].endswith(
        "digital zoom 2 (EXIF DigitalZoomRatio 2): unknown whether FocalLengthIn35mmFilm 26 mm includes it; "
        "the focal length is estimated"
    )


def test_zoomed_photographs_that_no_metadata_tell_apart_are_named() -> None:
    camera = Camera(width_px=4000, height_px=3000, fx_px=3000, fy_px=3000, cx_px=2000, cy_px=1500)
    still = Similarity(rotation=np.eye(3), translation=np.zeros(3))
    photos = tuple(
        LocalisedPhoto(
            photo_id=name, camera=camera, sfm_from_cam=still, reprojection_error_px=0.4, tie_points=500,
            focal_factor=factor, focal_factor_sigma=0.001 if factor > 1 else 0.0,
        )
        for name, factor in (("a.jpg", 1.0), ("b.jpg", 1.3))
    )  # fmt: skip
    empty = np.zeros(0, dtype=np.int64)
    block = Reconstruction(
        photos=photos, unlocalised=(), xyz_sfm=np.zeros((0, 3)), rgb=np.zeros((0, 3), dtype=np.uint8),
        image_point_photo=empty, image_point_tie_point=empty, image_point_xy_img=np.zeros((0, 2)),
        mean_reprojection_error_px=0.4, costs=(),
    )  # fmt: skip
    assert block.list_focal_deviations() == [
        "1 photographs have another focal length than the others by their camera (a zoom that the metadata do not "
        "state?), in multiples: b.jpg 1.300 (sigma 0.001); they have a camera of their own in the adjustment"
    ]
