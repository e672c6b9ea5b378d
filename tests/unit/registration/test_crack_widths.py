"""Cracks from pixels to millimetres on the wall, and the combination of several observations."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
import shapely

from facadelake.building.surface.raycasting import Surface
from facadelake.deduplication.crack_width import CrackWidthEstimate, estimate_crack_widths
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from tests.unit.registration.wall_scene import look_at

SETTINGS = RegistrationSettings()
ASIDE = look_at([-8.0, -6.0, 2.0], [0.0, 0.0, 2.0])  # 53 deg from the wall's normal


def seen_line(posed, *corners_site):
    """A line on the wall y = 0 as the photograph shows it."""
    xz = shapely.get_coordinates(shapely.segmentize(shapely.linestrings(np.array(corners_site)), 0.05))
    return posed.project_site(np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]]))


def measured(detections_of, posed, wall, line, **columns):
    """The observation of a crack whose line is ``line`` (k, 2: x, z on the wall), its box about it."""
    img = seen_line(posed, *line)
    low, size = img.min(axis=0), np.maximum(np.ptp(img, axis=0), 4.0)
    made = detections_of(
        ("a", "p", "crack", (*low, *size)),
        crack_line=shapely.to_wkt(shapely.linestrings(img), rounding_precision=6),
        crack_width_outcome="measured",
        **columns,
    )
    [row] = observe_detections(made, {"p": posed}, wall, Surface(wall), SETTINGS).to_pylist()
    return row


@pytest.mark.parametrize(
    "line", [[(0.0, 1.5), (0.0, 2.5)], [(-0.5, 2.0), (0.5, 2.0)], [(-0.4, 1.5), (0.3, 2.4)], [(-0.4, 2.3), (0.4, 1.6)]]
)
def test_a_bands_width_and_length_come_back_from_its_two_edges(wall, detections_of, line):
    """The other way round: both edges of a band on the wall are projected, and their distance in pixels is stated."""
    wide = 0.02
    start, end = np.array(line)
    normal = np.array([-(end - start)[1], (end - start)[0]]) / np.linalg.norm(end - start)
    edges = [seen_line(ASIDE, start + by * normal, end + by * normal) for by in (-wide / 2, wide / 2)]
    middle = shapely.linestrings(seen_line(ASIDE, start, end))
    points = shapely.points(shapely.get_coordinates(shapely.segmentize(middle, 2.0)))
    apart = sum(shapely.distance(points, shapely.linestrings(edge)) for edge in edges)
    row = measured(
        detections_of, ASIDE, wall, line, crack_width_px=float(apart[2:-2].mean()), crack_width_max_px=20.0,
        crack_width_sigma_px=0.1, crack_width_limit_px=1.2,
    )  # fmt: skip
    np.testing.assert_allclose(row["crack_width_mm"], 1000 * wide, rtol=0, atol=0.3)  # mm
    np.testing.assert_allclose(row["crack_length_m"], np.linalg.norm(end - start), rtol=0, atol=0.005)  # m
    scale = row["crack_width_mm"] / float(apart[2:-2].mean())
    np.testing.assert_allclose(row["crack_width_limit_mm"], 1.2 * scale, rtol=0, atol=1e-6)  # mm
    np.testing.assert_allclose(row["crack_width_max_mm"], 20.0 * scale, rtol=0, atol=1e-6)  # mm
    # 1 deg of slope at 53 deg is 2.3 % of the width, the surface's 3 cm along the ray 0.5 %.
    by_scale = 0.024 * row["crack_width_mm"]
    assert np.hypot(0.1 * scale, 0.8 * by_scale) < row["crack_width_sigma_mm"] < np.hypot(0.1 * scale, 1.4 * by_scale)
    assert row["crack_width_outcome"] == "measured"


def test_below_the_limit_there_is_a_limit_and_no_width(wall, detections_of):
    row = measured(detections_of, ASIDE, wall, [(0.0, 1.5), (0.0, 2.5)], crack_width_limit_px=1.5)
    assert (row["crack_width_mm"], row["crack_width_sigma_mm"]) == (None, None)
    np.testing.assert_allclose(row["crack_width_limit_mm"], 1.5 * 10000 / 1500 / 0.6, rtol=0.01, atol=0)  # mm


def combine(*observations: tuple[str | None, float | None, float | None, float | None]) -> CrackWidthEstimate:
    """One crack of observations (outcome, width, sigma, limit), all of equal weight."""
    names = ("crack_width_outcome", "crack_width_mm", "crack_width_sigma_mm", "crack_width_limit_mm")
    columns = {name: [one[i] for one in observations] for i, name in enumerate(names)}
    types = {name: pa.string() if name.endswith("outcome") else pa.float64() for name in names}
    table = pa.table({name: pa.array(values, types[name]) for name, values in columns.items()})
    table = table.append_column("crack_width_max_mm", table.column("crack_width_mm"))
    count = len(observations)
    table = table.append_column("gsd_mm", pa.array(np.full(count, 2.0)))
    return estimate_crack_widths(table, np.zeros(count, dtype=np.int64), np.ones(count), 1)


def test_the_most_accurate_observation_dominates_and_the_combination_is_not_more_accurate():
    found = combine(("measured", 4.0, 0.2, 1.0), ("measured", 4.1, 2.0, 3.0), ("measured", 6.0, 2.0, 3.0))
    assert found.outcome.to_pylist() == ["measured"]
    np.testing.assert_allclose(found.width_mm, 4.0, rtol=0, atol=0.11)  # mm
    assert 0.2 < found.sigma_mm[0] < 0.4  # mm
    np.testing.assert_allclose(found.limit_mm, 1.0, rtol=0, atol=0)  # mm


def test_one_measurement_goes_before_any_limit_and_the_smallest_limit_is_the_bound():
    assert combine(("below_limit", None, None, 5.0), ("measured", 4.0, 0.5, 2.0)).outcome.to_pylist() == ["measured"]
    bound = combine(("below_limit", None, None, 5.0), ("below_limit", None, None, 3.0), ("no_line", None, None, None))
    assert bound.outcome.to_pylist() == ["below_limit"]
    assert np.isnan(bound.width_mm[0])
    np.testing.assert_allclose(bound.limit_mm, 3.0, rtol=0, atol=0)  # mm


def test_a_coarse_photographs_width_beyond_a_better_ones_bound_is_left_out():
    found = combine(("measured", 9.0, 1.0, 6.0), ("below_limit", None, None, 3.0))
    assert found.outcome.to_pylist() == ["below_limit"]
    np.testing.assert_allclose(found.limit_mm, 3.0, rtol=0, atol=0)  # mm
    near = combine(("measured", 4.0, 1.0, 3.0), ("below_limit", None, None, 3.0))
    assert near.outcome.to_pylist() == ["measured"]


def test_what_a_person_stated_goes_before_what_was_measured():
    found = combine(("measured", 9.0, 0.1, 1.0), ("stated", 3.0, None, None))
    assert found.outcome.to_pylist() == ["stated"]
    np.testing.assert_allclose(found.width_mm, 3.0, rtol=0, atol=0)  # mm
    assert np.isnan(found.sigma_mm[0])


def test_other_classes_have_no_outcome():
    found = combine((None, None, None, None))
    assert found.outcome.to_pylist() == [None]
    assert np.isnan([found.width_mm[0], found.limit_mm[0]]).all()
