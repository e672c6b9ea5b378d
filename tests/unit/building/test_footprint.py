"""Outlines from above: exact of few triangles, of decimetre cells of many."""

import numpy as np
import shapely

from facadelake.building.surface.footprint import compute_outline


def roof(step_m: float) -> np.ndarray:
    """An L of 30 by 20 m without its quarter of 15 by 10 m in the north-east, as triangles (m, 3, 3) 5 m up."""
    x, y = np.meshgrid(np.arange(0, 30, step_m), np.arange(0, 20, step_m))
    corner = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)])
    corner = corner[(corner[:, 0] < 15 - 1e-9) | (corner[:, 1] < 10 - 1e-9)]
    a, b, c, d = (corner + np.array([*offset, 0]) * step_m for offset in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def test_many_triangles_have_the_outline_of_few_to_a_decimetre() -> None:
    few, many = compute_outline(roof(5.0)), compute_outline(roof(0.25))
    assert len(roof(0.25)) > 8_000 > len(roof(5.0))
    assert abs(few.area - (30 * 20 - 15 * 10)) < 1e-6  # m2
    assert shapely.hausdorff_distance(few.boundary, many.boundary) < 0.15  # m
    assert many.geom_type == "Polygon" and not many.interiors


def test_a_rough_wall_of_many_triangles_is_a_strip() -> None:
    rng = np.random.default_rng(2)
    s, z = rng.uniform(0, 40, 9000), rng.uniform(0, 8, 9000)
    middle = np.column_stack([s * 0.8, s * 0.6, z])  # along a wall that runs askew
    triangles = middle[:, None] + rng.normal(0, [0.05, 0.05, 0.1], (9000, 3, 3))
    strip = compute_outline(triangles)
    line = shapely.LineString([(0, 0), (32, 24)])
    assert 40 * 0.2 < strip.area < 40 * 0.8  # m2
    assert strip.buffer(0.3).covers(line)
    assert line.buffer(0.6).covers(strip)
