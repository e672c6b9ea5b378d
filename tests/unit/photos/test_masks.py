"""Mask files are recognised by name, and only where their photograph exists."""

from pathlib import Path

import pytest

from facadelake.photos.files import explain_unused_masks, find_masks, find_photographs


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
        ("DJI_1.JPG", "dji_1_MASK.PNG"),
        ("close/a.JPG", "Masks/Close/A.png"),
        ("close/a.JPG", "masks/a.png"),  # the only photograph of the name
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


def test_a_mask_that_several_photographs_match_is_told(tmp_path: Path) -> None:
    files(tmp_path, "x/a.jpg", "y/a.jpg", "masks/a.png", "close/c_mask.png", "c.jpg")
    assert find_masks(tmp_path) == {}
    assert explain_unused_masks(tmp_path) == {
        tmp_path / "masks/a.png": "named like a mask, and used as a photograph: 'a' matches x/a.jpg, y/a.jpg; give its "
        "folder, too; rename it, or delete it",
        tmp_path / "close/c_mask.png": "named like a mask, and used as a photograph: 'close/c' is not beside it; c.jpg "
        "is in another folder; rename it, or delete it",
    }


def test_one_name_with_two_suffixes_has_one_mask(tmp_path: Path) -> None:
    files(tmp_path, "a.jpg", "a.tif", "a_mask.png")
    assert find_masks(tmp_path) == {"a.jpg": tmp_path / "a_mask.png", "a.tif": tmp_path / "a_mask.png"}
