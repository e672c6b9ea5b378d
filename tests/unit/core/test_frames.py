"""Transforms: inverses, chains, the similarity of point pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity

numbers = st.floats(-1e4, 1e4, allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
similarities = st.builds(
    lambda turn, translation, scale: Similarity(
        rotation=Rotation.from_rotvec(turn / 1e3).as_matrix(), translation=translation, scale=scale
    ),
    vectors,
    vectors,
    st.floats(1e-3, 1e3),
)


@given(similarities, vectors)
def test_inverse_undoes(transform: Similarity, xyz: np.ndarray) -> None:
    back = transform.invert().apply(transform.apply(xyz))
    np.testing.assert_allclose(back, xyz, rtol=0, atol=1e-6 * max(1.0, 1.0 / transform.scale))


@given(similarities, similarities, vectors)
def test_a_chain_is_one_after_the_other(a: Similarity, b: Similarity, xyz: np.ndarray) -> None:
    np.testing.assert_allclose((a @ b).apply(xyz), a.apply(b.apply(xyz)), rtol=1e-9, atol=1e-4)


def test_apply_against_numbers_done_by_hand() -> None:
    """A quarter turn about z, doubled, shifted: (1, 0, 5) -> 2 (0, 1, 5) + (10, 20, 30)."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    transform = Similarity(rotation=quarter, translation=np.array([10.0, 20, 30]), scale=2.0)
    np.testing.assert_allclose(transform.apply(np.array([1.0, 0, 5])), [10, 22, 40], rtol=0, atol=1e-12)
    np.testing.assert_allclose(transform.rotate(np.array([1.0, 0, 5])), [0, 1, 5], rtol=0, atol=1e-12)


@given(similarities)
def test_similarity_between_finds_it_again(transform: Similarity) -> None:
    source = np.random.default_rng(1).normal(size=(6, 3)) * 10
    found = estimate_similarity(source, transform.apply(source), np.arange(1.0, 7.0))
    np.testing.assert_allclose(found.rotation, transform.rotation, rtol=0, atol=1e-7)
    assert found.scale == pytest.approx(transform.scale, rel=1e-7)


def test_similarity_between_never_mirrors() -> None:
    source = np.random.default_rng(2).normal(size=(8, 3))
    found = estimate_similarity(source, source * [1, 1, -1])
    assert np.linalg.det(found.rotation) == pytest.approx(1.0, abs=1e-9)


def test_what_a_similarity_refuses() -> None:
    points = np.random.default_rng(3).normal(size=(5, 3))
    with pytest.raises(GeoreferenceError, match="3 or more point pairs, 2 were given"):
        estimate_similarity(points[:2], points[:2])
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(GeoreferenceError, match="lie on one line"):
        estimate_similarity(line, points)
    with pytest.raises(GeoreferenceError, match="not a proper rotation"):
        Similarity(rotation=np.diag([1.0, 1, -1]), translation=np.zeros(3))
    with pytest.raises(GeoreferenceError, match=r"scale of a transform is 0\.0"):
        Similarity(rotation=np.eye(3), translation=np.zeros(3), scale=0.0)
