"""Merging, statistics and the truth folder, each by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facadelake.core.errors import InputDataError
from facadelake.evaluation.campaigns.merging import compute_merge_figures
from facadelake.evaluation.campaigns.statistics import ErrorStatistics, compute_statistics, compute_surface_axes
from facadelake.evaluation.campaigns.truth import read_truth
from tests.unit.evaluation.campaigns.campaigns import write_csv


def test_merging_by_hand() -> None:
    """Defect a holds truths 1 1 2, b holds 2 2, c holds 3.

    Decided pairs 3 + 1 = 4, true pairs 1 + 3 = 4, both 1 (in a) + 1 (in b) = 2. Only truth 3 is whole and alone.
    """
    merging = compute_merge_figures([("a", "1"), ("a", "1"), ("a", "2"), ("b", "2"), ("b", "2"), ("c", "3")])
    assert (merging.precision, merging.recall, merging.f1) == (0.5, 0.5, 0.5)
    assert merging.clusters_exact == pytest.approx(1 / 3)


def test_merging_without_pairs() -> None:
    alone = compute_merge_figures([("a", "1"), ("b", "2")])
    assert (alone.precision, alone.recall, alone.f1, alone.clusters_exact) == (None, None, None, 1.0)
    assert compute_merge_figures([]).clusters_exact is None
    split = compute_merge_figures([("a", "1"), ("b", "1")])
    assert (split.precision, split.recall, split.f1, split.clusters_exact) == (None, 0.0, 0.0, 0.0)
    lumped = compute_merge_figures([("a", "1"), ("a", "2")])
    assert (lumped.precision, lumped.recall, lumped.f1) == (0.0, None, 0.0)


def test_statistics_by_hand() -> None:
    stats = compute_statistics(np.array([-3.0, 1.0, 1.0, 5.0]))
    assert stats == ErrorStatistics(n=4, mean=1.0, median=1.0, mae=2.5, rmse=3.0, p95=stats.p95, iqr=2.0)
    assert stats.p95 == pytest.approx(4.7)  # of 1 1 3 5: three and 0.85 of the way to five
    assert compute_statistics(np.zeros(0)) == ErrorStatistics(n=0)


@pytest.mark.parametrize(
    ("normal", "horizontal", "vertical"),
    [
        ((0, -1, 0), (1, 0, 0), (0, 0, 1)),  # a wall to the south: seen from there, east is right
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),  # to the east: north is right
        ((0, -0.8, 0.6), (1, 0, 0), (0, 0.6, 0.8)),  # a roof rising to the north
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)),  # a flat roof
    ],
)
def test_directions_along_a_surface(
    normal: tuple[float, ...], horizontal: tuple[float, ...], vertical: tuple[float, ...]
) -> None:
    right, up = compute_surface_axes(np.array([normal], dtype=np.float64))
    assert right[0] == pytest.approx(horizontal, rel=0, abs=1e-12)
    assert up[0] == pytest.approx(vertical, rel=0, abs=1e-12)


GEO = ["lon_deg", "lat_deg", "height_ellipsoidal_m"]
IMAGE = ["image", *GEO]
SHOWN = ["file", "annotation_id", "checkpoint_id"]


def truth_folder(folder: Path) -> Path:
    write_csv(folder / "cameras.csv", ["image", *GEO], [["a.jpg", 8.4, 48.9, 180]])
    write_csv(folder / "checkpoints.csv", ["id", *GEO, "element_guid"], [["C1", 8.4, 48.9, 181, "guid"]])
    shown = [["b.json", 1, "C1"], ["b.json", 2, "off_target"]]
    write_csv(folder / "detections.csv", SHOWN, shown)
    return folder


def test_truth_is_read(tmp_path: Path) -> None:
    truth = read_truth(truth_folder(tmp_path))
    assert truth.check_point_of_annotation == {("b.json", "1"): "C1", ("b.json", "2"): None}
    assert truth.checkpoints["C1"].element_guid == "guid"
    assert truth.checkpoints["C1"].geo.tolist() == [8.4, 48.9, 181.0]
    assert truth.cameras["a.jpg"].tolist() == [8.4, 48.9, 180.0]


@pytest.mark.parametrize(
    ("file", "columns", "rows", "message"),
    [
        ("cameras.csv", ["image", "lon_deg"], [], r"cameras.csv has no column height_ellipsoidal_m, lat_deg \(it has"),
        ("cameras.csv", IMAGE, [["a.jpg", 8.4, "north", 1]], r"line 2, column lat_deg: 'north' is not a number"),
        ("cameras.csv", IMAGE, [["a.jpg", 8.4, 91, 1]], r"column lat_deg: '91' is not a number from -90 to 90"),
        ("cameras.csv", IMAGE, [["a.jpg", 8.4, 48, "nan"]], r"column height_ellipsoidal_m: 'nan' is not a number"),
        ("cameras.csv", IMAGE, [["a.jpg", 8.4]], r"column lat_deg: '' is not a number"),
        ("cameras.csv", IMAGE, [["a", 8, 48, 1], ["a", 8, 48, 1]], r"line 3, column image: 'a' is empty or"),
        ("checkpoints.csv", ["id", *GEO], [], r"checkpoints.csv has no column element_guid"),
        ("detections.csv", SHOWN, [["b", 1, "C9"]], r"line 2, column checkpoint_id: 'C9' is neither"),
        ("detections.csv", SHOWN, [["b", 1, "C1"], ["b", 1, "C1"]], r"line 3: annotation 1 of b is listed twice"),
    ],
)  # fmt: skip
def test_truth_that_is_ill_formed_is_refused(
    tmp_path: Path, file: str, columns: list[str], rows: list[list[object]], message: str
) -> None:
    truth_folder(tmp_path)
    write_csv(tmp_path / file, columns, rows)
    with pytest.raises(InputDataError, match=message):
        read_truth(tmp_path)


@pytest.mark.parametrize("file", ["cameras.csv", "checkpoints.csv", "detections.csv"])
def test_truth_that_is_missing_is_refused(tmp_path: Path, file: str) -> None:
    (truth_folder(tmp_path) / file).unlink()
    with pytest.raises(InputDataError, match=f"truth file .*{file} cannot be read .No such file or directory"):
        read_truth(tmp_path)
