"""Names of photographs as other programs write them: what is matched, and which ambiguity is named."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facadelake.core.photo_names import PhotoNames

PHOTOS = [
    "multiview/DJI_0001.JPG",
    "closerange/DJI_0001.JPG",
    "closerange/DJI 0033.JPG",
    "closerange/Köln.JPG",
    "b.tif",
]


@pytest.mark.parametrize(
    ("name", "photo_id"),
    [
        ("multiview/DJI_0001.JPG", "multiview/DJI_0001.JPG"),
        ("multiview/dji_0001.jpeg", "multiview/DJI_0001.JPG"),
        ("multiview/DJI_0001", "multiview/DJI_0001.JPG"),
        ("images/multiview/DJI_0001.JPG", "multiview/DJI_0001.JPG"),
        (r"D:\Flug\images\multiview\DJI_0001.JPG", "multiview/DJI_0001.JPG"),
        ("./multiview/DJI_0001.JPG", "multiview/DJI_0001.JPG"),
        ("../b/./../images//multiview/DJI_0001.JPG", "multiview/DJI_0001.JPG"),
        ('"multiview/DJI_0001.JPG"', "multiview/DJI_0001.JPG"),
        (" 'DJI 0033.JPG' ", "closerange/DJI 0033.JPG"),
        ("DJI 0033", "closerange/DJI 0033.JPG"),
        (unicodedata.normalize("NFD", "Köln.jpg"), "closerange/Köln.JPG"),
        ("B.TIFF", "b.tif"),
        ("other/b.tif", "b.tif"),
        ("b", "b.tif"),
    ],
)
def test_names_as_other_programs_write_them(name: str, photo_id: str) -> None:
    match = PhotoNames(PHOTOS).match(name)
    assert (match.photo_id, match.reason) == (photo_id, "")
    assert PhotoNames(PHOTOS).match_all([name])[name] == match


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        (
            "DJI_0001.JPG",
            "'DJI_0001.JPG' matches closerange/DJI_0001.JPG, multiview/DJI_0001.JPG; give its folder, too",
        ),
        ("DJI_0001", "'DJI_0001' matches closerange/DJI_0001.JPG, multiview/DJI_0001.JPG; give its folder, too"),
        (
            "night/DJI_0001.JPG",
            "'night/DJI_0001.JPG' is not in the campaign; closerange/DJI_0001.JPG is in another folder",
        ),
        ("DJI_0001.png", "'DJI_0001.png' is not among the campaign's photographs"),
        ("", "'' names no photograph"),
        ('""', "'\"\"' names no photograph"),
    ],
)
def test_names_that_match_nothing_or_more_than_one(name: str, reason: str) -> None:
    match = PhotoNames(PHOTOS).match(name)
    assert (match.photo_id, match.reason) == (None, reason)


def test_equal_case_decides_between_names_that_differ_by_nothing_else() -> None:
    names = PhotoNames(["a/x.jpg", "a/x.JPG", "y.JPG", "y.DNG"])
    assert names.match("b/a/x.jpg").photo_id == "a/x.jpg"
    assert names.match("X.jpg").reason == "'X.jpg' matches a/x.JPG, a/x.jpg; give its suffix as the file has it, too"
    assert names.match("y").reason == "'y' matches y.DNG, y.JPG; give its suffix as the file has it, too"


def test_the_longest_common_end_decides() -> None:
    names = PhotoNames(["IMG.JPG", "b/IMG.JPG"])
    assert names.match("a/b/IMG.JPG").photo_id == "b/IMG.JPG"
    assert names.match("a/IMG.JPG").photo_id == "IMG.JPG"


def test_a_file_without_folders_does_not_mean_the_photograph_outside_folders() -> None:
    """`IMG.JPG` alone is a photo_id; among names without any folder it may be b/IMG.JPG as well."""
    names = PhotoNames(["IMG.JPG", "b/IMG.JPG", "c.JPG"])
    assert names.match("IMG.JPG").photo_id == "IMG.JPG"
    found = names.match_all(["IMG.JPG", "c.JPG"])
    assert found["IMG.JPG"].reason == "'IMG.JPG' matches IMG.JPG, b/IMG.JPG; give its folder, too"
    assert found["c.JPG"].photo_id == "c.JPG"
    assert names.match_all(["IMG.JPG", "b/IMG.JPG"])["IMG.JPG"].photo_id == "IMG.JPG"
    assert names.match_all(["IMG.JPG", "images/c.JPG"])["IMG.JPG"].candidates == ("IMG.JPG", "b/IMG.JPG")
    assert names.match_all(["./IMG.JPG"])["./IMG.JPG"].photo_id == "IMG.JPG"


def test_two_folders_of_the_file_that_end_as_one_photograph() -> None:
    """A file of two campaigns: cameras restart their counters, so the names end alike."""
    found = PhotoNames(["IMG_1.JPG", "IMG_2.JPG"]).match_all(
        ["2026-04/IMG_1.JPG", "2026-10/IMG_1.JPG", "2026-04/IMG_2.JPG"]
    )
    reason = (
        "'2026-04/IMG_1.JPG', '2026-10/IMG_1.JPG' match the same photograph IMG_1.JPG; write its path in one way, as "
        "the campaign has it"
    )
    assert [match.reason for match in found.values()] == [reason, reason, ""]
    assert found["2026-04/IMG_2.JPG"].photo_id == "IMG_2.JPG"
    alike = PhotoNames(["c/IMG_1.JPG"]).match_all(["c/IMG_1.JPG", r"C\img_1.jpg", "./c/IMG_1"])
    assert {match.photo_id for match in alike.values()} == {"c/IMG_1.JPG"}


FILES = st.lists(st.sampled_from("ab"), min_size=1, max_size=3).map(lambda parts: "/".join(parts) + ".JPG")


@given(photo_ids=st.sets(FILES, min_size=1), name=FILES)
def test_a_match_is_an_end_of_the_other_path_and_no_other_fits_as_well(photo_ids: set[str], name: str) -> None:
    """Against the definition by text: one path ends with the other; the only such, or the only longest common end."""

    def common(photo_id: str) -> int:
        shorter, longer = sorted([f"/{name}", f"/{photo_id}"], key=len)
        return len(shorter) if longer.endswith(shorter) else 0

    found = PhotoNames(photo_ids).match(name)
    longest = max(map(common, photo_ids))
    fitting = [photo_id for photo_id in photo_ids if longest and common(photo_id) == longest]
    expected = name if name in photo_ids else fitting[0] if len(fitting) == 1 else None
    assert found.photo_id == expected
    assert bool(found.reason) == (expected is None)
