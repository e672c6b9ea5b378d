"""The true track states of histories written out by hand, and those of the demo's recipe."""

from __future__ import annotations

from itertools import pairwise

import pytest

from facadelake.demo.defect_recipe import DefectClass, DefectState, DemoDefect
from facadelake.demo.history import ImagedDefect, derive_track_state
from facadelake.demo.recipe import DemoRecipe

# What the product calls a track's state after a campaign; 'not_found' is a statement about a detector, never true.
TRACK_STATES = {"", "new", "first_seen", "seen", "grown", "shrunk", "repaired", "not_imaged", "reopened"}


def list_track_states(
    states: str, photographs: list[int], sizes: list[float] | None = None, kinds: list[DefectClass] | None = None
) -> list[str]:
    """The track states of a defect after each campaign."""
    names: list[DefectState] = states.split()  # type: ignore[assignment]  # checked by the recipe
    defect = DemoDefect(
        id="D", kind="spalling", surface="south", u_m=1.0, v_m=1.0, width_m=0.2, height_m=0.1,
        states=names, sizes=sizes or [], kinds=kinds or [],
    )  # fmt: skip
    history = [ImagedDefect(day=defect.describe_day(n), photographs=seen) for n, seen in enumerate(photographs)]
    return [derive_track_state(history[: n + 1]) for n in range(len(history))]


@pytest.mark.parametrize(
    ("states", "photographs", "track_states"),
    [
        ("present present", [3, 3], ["first_seen", "seen"]),
        ("absent new present", [3, 3, 3], ["", "new", "seen"]),
        # Nobody looked before: of unknown age, whenever it came about.
        ("present present present", [0, 2, 2], ["", "first_seen", "seen"]),
        ("absent new present", [0, 2, 2], ["", "first_seen", "seen"]),
        # It came about behind a scaffold: nobody can have seen it; later it is new, for the first one saw the wall.
        ("absent new present", [2, 0, 2], ["", "", "new"]),
        ("present present present", [2, 0, 2], ["first_seen", "not_imaged", "seen"]),
        # Gone stays gone: each campaign that looks says so, and one that does not look says nothing.
        ("present repaired repaired repaired", [2, 2, 0, 2], ["first_seen", "repaired", "not_imaged", "repaired"]),
        ("present repaired repaired", [2, 0, 2], ["first_seen", "not_imaged", "repaired"]),
        ("present repaired reopened present", [2, 2, 2, 2], ["first_seen", "repaired", "reopened", "seen"]),
        # The repair and its failure between two looks are not seen.
        ("present repaired reopened present", [2, 0, 2, 2], ["first_seen", "not_imaged", "seen", "seen"]),
        # It opened again unseen; the campaign that looks is the one that finds it open.
        ("present repaired reopened present", [2, 2, 0, 2], ["first_seen", "repaired", "not_imaged", "reopened"]),
        # Never seen before its repair: there is nothing to say about it.
        ("present repaired repaired", [0, 2, 2], ["", "", ""]),
        ("present repaired reopened", [0, 2, 2], ["", "", "new"]),
    ],
)
def test_track_states_say_what_can_be_known(states: str, photographs: list[int], track_states: list[str]) -> None:
    assert list_track_states(states, photographs) == track_states


def test_growth_counts_from_the_last_campaign_that_imaged_the_place() -> None:
    sizes = [1.0, 1.3, 1.3, 1.0]
    states = "present grown present shrunk"
    assert list_track_states(states, [1, 1, 1, 1], sizes) == ["first_seen", "grown", "seen", "shrunk"]
    assert list_track_states(states, [1, 0, 1, 1], sizes) == ["first_seen", "not_imaged", "grown", "shrunk"]
    assert list_track_states(states, [1, 0, 0, 1], sizes) == ["first_seen", "not_imaged", "not_imaged", "seen"]


def test_a_crack_that_spalls_is_seen_and_of_another_class() -> None:
    kinds: list[DefectClass] = ["crack", "crack", "spalling"]
    assert list_track_states("present present present", [1, 1, 1], kinds=kinds) == ["first_seen", "seen", "seen"]


def test_the_recipe_tells_every_kind_of_history(recipe: DemoRecipe) -> None:
    """As if all places were imaged by all campaigns; what the photographs show is in the truth of a generated demo."""
    histories = {
        d.id: [ImagedDefect(day=d.describe_day(n), photographs=1) for n in range(len(recipe.campaigns))]
        for d in recipe.defects
    }
    tracks = {i: [derive_track_state(h[: n + 1]) for n in range(len(h))] for i, h in histories.items()}
    used = {state for states in tracks.values() for state in states}
    assert used == TRACK_STATES - {"not_imaged"}
    unchanged = [i for i, states in tracks.items() if states == ["first_seen", "seen", "seen", "seen"]]
    assert len(unchanged) >= 15
    spalled = [d for d in recipe.defects if len(set(d.kinds)) > 1]
    assert len(spalled) >= 1
    assert all(d.kinds[-1] == d.kind for d in spalled)
    # A steady growth, to which a trend can be fitted: equal steps of size within a quarter of their mean.
    steps = [[after - before for before, after in pairwise(d.sizes)] for d in recipe.defects if d.sizes]
    assert sum(max(one) < 1.25 * min(one) for one in steps) >= 3


def test_campaigns_are_in_the_order_of_their_days(recipe: DemoRecipe) -> None:
    assert [c.id for c in recipe.campaigns] == ["2025-04", "2025-10", "2026-04", "2026-10"]
    assert all(c.starts.startswith(c.id) for c in recipe.campaigns)
    assert [c.has_control_points for c in recipe.campaigns] == [False, False, True, True]


def test_an_older_drone_has_the_same_view_in_fewer_pixels(recipe: DemoRecipe) -> None:
    older, newer = (recipe.find_optics(recipe.campaigns[n]) for n in (0, 2))
    assert newer == recipe.optics
    assert (older.width_px, older.height_px, older.focal_mm) == (1280, 960, 5.0)
    for side in ("width", "height"):
        axis = "x" if side == "width" else "y"
        views = [getattr(o, f"{side}_px") / getattr(o, f"f{axis}_px") for o in (older, newer)]
        assert abs(views[0] - views[1]) < 1e-9
    assert older.width_px * older.pitch_um == pytest.approx(newer.width_px * newer.pitch_um, rel=0, abs=1e-6)  # um
