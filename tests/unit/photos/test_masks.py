"""Mask files are recognised by name, and only where their photograph exists."""

from pathlib import Path

import pytest

from facadelake.photos.files import find_masks, find_photographs


def files(root: Path, *names: str) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")


@pytest.mark.parametrize(
    ("photograph", "mask"),
    [
        ("a.JPG", "a_mask.png"),
        ("close/a.JPG", "close/a_mask.JPG"),
        ("close/a.JPG", "masks/close/a.JPG.png"),
        ("close/a.JPG", "masks/close/a.png"),
    ],
)
def test_a_mask_belongs_to_its_photograph_and_is_none(tmp_path: Path, photograph: str, mask: str) -> None:
    files(tmp_path, photograph, mask, "other.jpg")
    assert find_masks(tmp_path) == {photograph: tmp_path / mask}
    assert {path.relative_to(tmp_path).as_posix() for path in find_photographs(tmp_path)} == {photograph, "other.jpg"}


def test_a_name_like_a_masks_without_a_photograph_is_a_photograph(tmp_path: Path) -> None:
    files(tmp_path, "venetian_mask.jpg", "masks/b.png", "close/c_mask.png", "c.jpg")
    assert find_masks(tmp_path) == {}
    assert len(find_photographs(tmp_path)) == 4
