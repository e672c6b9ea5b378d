"""Registration of synthetic scenes with known truth: own projections, own surfaces, simulated errors.

Bounds are two-sided where errors were drawn: a covariance that covers everything is as wrong as one that covers little.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import PosedCamera
from facadelake.deduplication.merge import MergeResult, merge_observations
from facadelake.deduplication.settings import MergeSettings
from facadelake.registration.exclusion import ExclusionEvidence, ExclusionSettings, exclude_observations
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from facadelake.registration.tie_points import BlockImagePoints, triangulate_tie_points
from schemas.vocabulary import ObservationOutcome
from tests.synthetic.registration_scene import (
    HEIGHT,
    WIDTH,
    Defect,
    DetectionStyle,
    DrawnDetections,
    Shot,
    Wall,
    aim_shot,
    build_walls,
    draw_detections,
    fan,
    shift_defects,
)

REGISTER, MERGE = RegistrationSettings(), MergeSettings()
KINDS = ("flat", "cylinder", "setback")
FAN = (-60.0, -30.0, 0.0, 30.0, 60.0)
CHI2_95, CHI2_68 = 7.815, 3.527  # of three degrees of freedom
BOXES = DetectionStyle(jitter=REGISTER.box_sigma_share, pixel_px=REGISTER.pixel_sigma_px)
Row = dict[str, object]


def place(row: Row) -> np.ndarray:
    return np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]], dtype=float)


def grid(wall: int, us: Sequence[float], vs: Sequence[float], **values: object) -> list[Defect]:
    return [Defect(name=f"{wall}-{u:g}-{v:g}", wall=wall, u=u, v=v, **values) for u in us for v in vs]  # type: ignore[arg-type]


def exact(shots: Sequence[Shot]) -> dict[str, PosedCamera]:
    return {shot.name: shot.stated() for shot in shots}


def observed(
    walls: Sequence[Wall],
    found: DrawnDetections,
    posed: Mapping[str, PosedCamera],
    covariance: np.ndarray | None = None,
) -> pa.Table:
    model = build_walls(walls)
    stated = {} if covariance is None else dict.fromkeys(posed, covariance)
    return observe_detections(found.table, posed, model, Surface(model), settings=REGISTER, covariances=stated)


def merged(
    walls: Sequence[Wall],
    found: DrawnDetections,
    posed: Mapping[str, PosedCamera],
    covariance: np.ndarray | None = None,
) -> MergeResult:
    stated = {} if covariance is None else dict.fromkeys(posed, covariance)
    seen = observed(walls, found, posed, covariance)
    return merge_observations(
        seen, found.table, build_walls(walls), posed, prefix="t", settings=MERGE, covariances=stated
    )


def truths(result: MergeResult, found: DrawnDetections) -> dict[str, Defect]:
    """The true defect of most observations of each defect."""
    votes: dict[str, Counter[Defect]] = defaultdict(Counter)
    for row in result.observations.to_pylist():
        if row["defect_id"] is not None:
            votes[row["defect_id"]][found.truth[row["detection_id"]]] += 1
    return {name: count.most_common(1)[0][0] for name, count in votes.items()}


def pairwise_f1(result: MergeResult, found: DrawnDetections) -> float:
    """Of "same defect" decisions."""
    pairs = [(found.truth[r["detection_id"]].name, r["defect_id"]) for r in result.observations.to_pylist()]
    pairs = [pair for pair in pairs if pair[1] is not None]

    def same(labels: Sequence[object]) -> float:
        return sum(n * (n - 1) / 2 for n in Counter(labels).values())

    return 2 * same(pairs) / (same([a for a, _ in pairs]) + same([b for _, b in pairs]))


def misses(rows: Sequence[Row], true: Sequence[np.ndarray]) -> np.ndarray:
    """Squared Mahalanobis distances from the truth, by the stated covariances."""
    out = []
    for row, at in zip(rows, true, strict=True):
        off = place(row) - at
        out.append(off @ np.linalg.solve(np.reshape(row["covariance_site"], (3, 3)), off))
    return np.array(out)


# One observation


@pytest.mark.parametrize(("masks", "kind", "bound_m"), [
    *((False, kind, 0.003) for kind in KINDS),  # the centre of a box is not exactly that of the defect
    *((True, kind, 0.001 if kind == "cylinder" else 1e-4) for kind in KINDS),  # facets leave the cylinder by 0.3 mm
])  # fmt: skip
def test_places_on_known_surfaces_up_to_60_degrees(masks: bool, kind: str, bound_m: float) -> None:
    walls = [Wall(kind=kind, foot=(40.0, -25.0, 3.0), bearing_deg=110.0)]
    shots = fan(walls[0], "p", FAN)
    defects = grid(0, (-2, 0, 2), (2.5, 3.5, 5.5, 6.5))
    found = draw_detections(walls, shots, defects, DetectionStyle(masks=masks), np.random.default_rng(0))
    rows = observed(walls, found, exact(shots)).to_pylist()
    assert len(rows) >= 50
    assert {row["observation_outcome"] for row in rows} == {"registered"}
    assert max(row["incidence_deg"] for row in rows) > 60
    for row in rows:
        defect = found.truth[row["detection_id"]]
        assert np.linalg.norm(place(row) - defect.xyz(walls)) < bound_m, row["detection_id"]
        assert row["element_guid"] == f"0-{walls[0].element_of(defect.v)}"
        normal = np.array([row["normal_x"], row["normal_y"], row["normal_z"]])
        assert normal @ walls[0].outward(np.array([defect.u]))[0] > np.cos(np.radians(1.1))  # a facet is 1 degree
        if masks:
            np.testing.assert_allclose([row["width_m"], row["height_m"]], 0.2, rtol=0, atol=0.002)  # m
            np.testing.assert_allclose(row["area_m2"], 0.04, rtol=0, atol=0.0006)  # m2


def test_the_centre_of_a_large_defect_seen_obliquely() -> None:
    """The centre of a box is 20 cm from that of a band of 3 m seen at 60 degrees: what is nearer appears larger."""
    walls = [Wall()]
    shots = fan(walls[0], "p", (-60.0, 60.0))
    bands = grid(0, (0,), (3.9, 4.1), width_m=3.0, height_m=0.1)
    found = draw_detections(walls, shots, bands, DetectionStyle(incidence_max_deg=80.0), np.random.default_rng(0))
    rows = observed(walls, found, exact(shots)).to_pylist()
    assert len(rows) == 4
    for row in rows:
        across, _, up = place(row) - found.truth[row["detection_id"]].xyz(walls)
        assert abs(across) < 0.02  # m
        assert abs(up) < 0.05  # m: the box is as high as the band's near end


def test_two_sigma_holds_nineteen_of_twenty_observations() -> None:
    """Poses, boxes and surface have simulated errors of the stated sigmas."""
    rng = np.random.default_rng(7)
    walls = [Wall(kind=KINDS[i % 3], foot=(60.0 * (i % 3), 60.0 * (i // 3), 0), bearing_deg=40.0 * i) for i in range(9)]
    shots = [shot for i, wall in enumerate(walls) for shot in fan(wall, f"w{i}", FAN)]
    whole = [defect for i in range(len(walls)) for defect in grid(i, (-2, 0, 2), (2.5, 3.5, 5.5, 6.5))]
    found = draw_detections(walls, shots, shift_defects(whole, REGISTER.model_sigma_m, rng), BOXES, rng)
    centre_m, turn_rad = 0.02, np.radians(0.1)
    posed = {s.name: s.stated(centre_m * rng.normal(size=3), turn_rad * rng.normal(size=3)) for s in shots}
    rows = observed(walls, found, posed, np.diag([centre_m**2] * 3 + [turn_rad**2] * 3)).to_pylist()
    squares = misses(rows, [found.truth[row["detection_id"]].xyz(walls) for row in rows])
    assert len(rows) > 450
    assert 0.92 < np.mean(squares < CHI2_95) < 0.98
    assert 0.60 < np.mean(squares < CHI2_68) < 0.76
    assert 2.5 < squares.mean() < 3.5


# Merged and triangulated


def test_relief_that_the_model_does_not_know_is_triangulated_and_kept_as_a_deviation() -> None:
    rng = np.random.default_rng(3)
    walls = [Wall(kind=kind, foot=(60.0 * i, 0, 0), bearing_deg=100.0 * i) for i, kind in enumerate(KINDS)]
    shots = [shot for i, wall in enumerate(walls) for shot in fan(wall, f"w{i}", FAN)]
    flush = [defect for i in range(3) for defect in grid(i, (-2, 0, 2), (2.5, 3.5, 5.5, 6.5))]
    defects = shift_defects(flush, 0.04, rng)
    found = draw_detections(walls, shots, defects, DetectionStyle(jitter=0.02, pixel_px=0.3), rng)
    result = merged(walls, found, exact(shots))
    own, rows = truths(result, found), result.defects.to_pylist()
    assert pairwise_f1(result, found) == 1.0
    assert len(rows) == len(defects)
    error = np.array([np.linalg.norm(place(row) - own[row["defect_id"]].xyz(walls)) for row in rows])
    alone = [
        np.linalg.norm(place(row) - found.truth[row["detection_id"]].xyz(walls))
        for row in result.observations.to_pylist()
    ]
    assert 0.02 < np.mean(alone) < 0.08  # m: the surface is 4 cm off, and the incidence is up to 60 degrees
    assert 0.001 < error.mean() < 0.006  # m
    assert np.percentile(error, 95) < 0.012  # m
    assert {row["position_method"] for row in rows} == {"triangulated"}
    off = np.array([own[row["defect_id"]].off_m for row in rows])
    stated = np.array([row["deviation_from_model_m"] for row in rows])
    sigma = np.array([row["deviation_sigma_m"] for row in rows])
    np.testing.assert_allclose(stated, off, rtol=0, atol=0.015)  # m
    assert np.corrcoef(stated, off)[0, 1] > 0.98
    assert 0.85 < np.mean(np.abs(stated - off) < 2 * sigma) <= 1.0


def test_two_sigma_holds_nineteen_of_twenty_defects() -> None:
    """Each wall's block has a common error; those of boxes and relief are independent."""
    rng = np.random.default_rng(1)
    walls = [
        Wall(kind=KINDS[i % 3], foot=(60.0 * (i % 5), 60.0 * (i // 5), 0), bearing_deg=40.0 * i) for i in range(10)
    ]
    shots = [shot for i, wall in enumerate(walls) for shot in fan(wall, f"{i}-w", FAN)]
    flush = [defect for i in range(len(walls)) for defect in grid(i, (-2, 0, 2), (2.5, 3.5, 5.5, 6.5))]
    found = draw_detections(
        walls,
        shots,
        shift_defects(flush, MERGE.relief_m, rng),
        DetectionStyle(jitter=MERGE.centre_share, pixel_px=0.5),
        rng,
    )
    block_m = 0.005
    moved = block_m * rng.normal(size=(len(walls), 3))
    posed = {shot.name: shot.stated(moved[int(shot.name.split("-")[0])]) for shot in shots}
    result = merged(walls, found, posed, np.diag([block_m**2] * 3 + [1e-14] * 3))
    own, rows = truths(result, found), result.defects.to_pylist()
    assert pairwise_f1(result, found) > 0.99
    squares = misses(rows, [own[row["defect_id"]].xyz(walls) for row in rows])
    assert 0.90 < np.mean(squares < CHI2_95) < 0.99
    assert 0.55 < np.mean(squares < CHI2_68) < 0.82


@pytest.mark.parametrize(("jitter", "least"), [(0.0, 1.0), (0.06, 0.97)])
@pytest.mark.parametrize("upright", [False, True])
def test_defects_20_cm_apart_are_kept_apart(jitter: float, least: float, upright: bool) -> None:
    """Pairs of the same class and size, 20 cm from centre to centre, side by side or one above the other."""
    walls = [Wall(kind=kind, foot=(60.0 * i, 0, 0), bearing_deg=70.0 * i) for i, kind in enumerate(KINDS)]
    shots = [shot for i, wall in enumerate(walls) for shot in fan(wall, f"w{i}", (-50, -20, 5, 30, 55))]
    size = {"width_m": 0.12, "height_m": 0.12}
    defects = []
    for i in range(3):
        for one in grid(i, (-2, 0, 2), (2.5, 6.0), **size):
            two = replace(one, name=f"{one.name}b", **({"v": one.v + 0.2} if upright else {"u": one.u + 0.2}))
            defects += [one, two]
    rng = np.random.default_rng(5)
    found = draw_detections(walls, shots, defects, DetectionStyle(jitter=jitter, pixel_px=0.5 if jitter else 0.0), rng)
    result = merged(walls, found, exact(shots))
    assert pairwise_f1(result, found) >= least
    for name in {row["defect_id"] for row in result.defects.to_pylist()}:
        sighted = [r for r in result.observations.to_pylist() if r["defect_id"] == name]
        assert len({found.truth[row["detection_id"]].name for row in sighted}) == 1, name
    if not jitter:
        assert len(result.defects) == len(defects)


def test_the_same_window_again_and_again_has_its_own_defect_each() -> None:
    """Thirty-two sills 0.9 m apart that look alike, seen by photographs that each show a part of the row."""
    walls = [Wall()]
    shots = [
        shot for k, u in enumerate((-6, -3, 0, 3, 6)) for shot in fan(walls[0], f"s{k}", (-35, 0, 35), u=u, far_m=7.0)
    ]
    sills = grid(0, np.arange(-7.2, 7.3, 0.9), (3.0, 5.5), width_m=0.5, height_m=0.15)
    rng = np.random.default_rng(2)
    found = draw_detections(walls, shots, sills, DetectionStyle(jitter=0.04, pixel_px=0.5), rng)
    result = merged(walls, found, exact(shots))
    assert len(result.defects) == len({defect.name for defect in found.truth.values()})
    assert pairwise_f1(result, found) == 1.0


def test_the_order_of_rows_and_photographs_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    walls = [Wall(kind="setback", bearing_deg=215.0)]
    shots = fan(walls[0], "p", FAN)
    near = grid(0, np.arange(-2, 2.1, 0.35), (2.5, 5.5), width_m=0.3, height_m=0.3)
    found = draw_detections(
        walls, shots, shift_defects(near, 0.05, rng), DetectionStyle(jitter=0.12, pixel_px=1.0), rng
    )
    first = merged(walls, found, exact(shots))
    order = rng.permutation(len(found.table))
    again = merged(walls, replace(found, table=found.table.take(pa.array(order))), exact(shots[::-1]))
    assert again.defects.equals(first.defects)
    assert again.merges.equals(first.merges)
    by_id = [("detection_id", "ascending")]
    assert again.observations.sort_by(by_id).equals(first.observations.sort_by(by_id))


def test_a_class_that_one_photograph_got_wrong_makes_no_second_defect() -> None:
    walls = [Wall(kind="cylinder", bearing_deg=160.0)]
    shots = fan(walls[0], "p", FAN)
    defects = grid(0, (-1.5, 0, 1.5), (2.5, 4.0, 5.5))
    wrong = {(defect.name, shots[i % 5].name): "moisture" for i, defect in enumerate(defects)}
    found = draw_detections(walls, shots, defects, DetectionStyle(renamed=wrong), np.random.default_rng(0))
    renamed = sum(row["defect_class"] == "moisture" for row in found.table.to_pylist())
    assert renamed >= 8
    result = merged(walls, found, exact(shots))
    assert len(result.defects) == len(defects)
    assert set(result.defects["defect_class"].to_pylist()) == {"crack"}
    outvoted = [row for row in result.merges.to_pylist() if row["merge_reason"] == "outvoted"]
    assert len({frozenset((row["detection_id"], row["other_detection_id"])) for row in outvoted}) >= renamed


def test_two_defects_of_two_classes_at_one_place_stay_two() -> None:
    walls = [Wall()]
    shots = fan(walls[0], "p", FAN)
    cracks = grid(0, (-1.5, 0, 1.5), (3.0, 5.0))
    damp = [replace(crack, name=f"{crack.name}m", kind="moisture") for crack in cracks]
    found = draw_detections(walls, shots, [*cracks, *damp], DetectionStyle(), np.random.default_rng(0))
    result = merged(walls, found, exact(shots))
    assert Counter(result.defects["defect_class"].to_pylist()) == {"crack": 6, "moisture": 6}


def test_one_pose_that_is_grossly_wrong_does_not_move_the_others_defects() -> None:
    """The pose of one photograph of six is wrong by 0.6 m: its observations are rejected or remain single."""
    walls = [Wall(kind="setback")]
    shots = fan(walls[0], "p", (-55, -35, -10, 10, 35, 55))
    defects = shift_defects(grid(0, (-2, -0.5, 1, 2.5), (2.5, 5.5)), 0.03, np.random.default_rng(8))
    found = draw_detections(walls, shots, defects, DetectionStyle(pixel_px=0.5, jitter=0.02), np.random.default_rng(8))
    posed = exact(shots) | {shots[2].name: shots[2].stated(np.array([0.45, 0.0, -0.4]))}
    result = merged(walls, found, posed)
    own = truths(result, found)
    seen_well = [row for row in result.defects.to_pylist() if row["photo_count"] >= 4]
    assert {own[row["defect_id"]].name for row in seen_well} == {defect.name for defect in defects}
    assert len(seen_well) == len(defects)
    for row in seen_well:
        assert np.linalg.norm(place(row) - own[row["defect_id"]].xyz(walls)) < 0.015, row["defect_id"]  # m


# Outcomes


def test_every_outcome_occurs_with_its_reason(tmp_path: Path) -> None:
    """A wall, a post in front of it with tie points, a mask, a photograph along the wall, and boxes without a ray."""
    walls = [Wall()]
    facing = fan(walls[0], "p", (-20, -10, 0, 10, 20), far_m=14.0)
    along = aim_shot("flat.jpg", np.array([-9.0, -0.9, 4.0]), np.array([2.0, 0.0, 4.0]))
    shots = [*facing, along]
    behind_post = Defect(name="hidden", wall=0, u=0.0, v=4.0)
    plain, masked = Defect(name="plain", wall=0, u=-2.0, v=4.0), Defect(name="masked", wall=0, u=2.0, v=4.0)
    far = Defect(name="far", wall=0, u=1.0, v=4.0)
    rng = np.random.default_rng(6)
    found = draw_detections(walls, facing, [plain, masked, behind_post], DetectionStyle(), rng)
    flat = draw_detections(walls, [along], [far], DetectionStyle(incidence_max_deg=89.0), rng)
    assert len(flat.table) == 1
    extra = []
    template = found.table.to_pylist()[0]
    above = facing[2].pixels(walls[0].points([(0.0, 9.6, 0.0)]))[0]
    for name, photo, x in (("sky", facing[2].name, above), ("outside", facing[2].name, [WIDTH + 90.0, 900.0]),
                           ("lost", "lost.jpg", [900.0, 900.0])):  # fmt: skip
        extra.append(template | {"detection_id": name, "photo_id": photo, "box_x_px": x[0] - 30,
                                 "box_y_px": x[1] - 30, "box_width_px": 60.0, "box_height_px": 60.0})  # fmt: skip
    table = pa.concat_tables([found.table, flat.table, pa.Table.from_pylist(extra, schema=found.table.schema)])

    posed = exact(shots)
    model = build_walls(walls)
    surface = Surface(model)
    seen = observe_detections(table, posed, model, surface, settings=REGISTER)

    # The post is 2 m in front of the wall; no photograph has tie points of what it occludes.
    post = np.array([(u, -2.0, v) for u in np.linspace(-0.6, 0.6, 7) for v in np.linspace(2.5, 5.5, 16)])
    bare = [(u, v, 0.0) for u in np.arange(-5, 5.1, 0.3) for v in np.arange(1, 7.1, 0.3) if abs(u) > 1.5]
    on_wall = walls[0].points(bare)
    sighted = [shot.pixels(np.vstack([post, on_wall])) for shot in facing]
    tracks = BlockImagePoints(
        photo_ids=[shot.name for shot in facing],
        photo=np.repeat(np.arange(len(facing)), len(sighted[0])),
        point=np.tile(np.arange(len(sighted[0])), len(facing)),
        xy_img=np.vstack(sighted) + 0.2 * rng.normal(size=(len(facing) * len(sighted[0]), 2)),
    )
    covered = np.full((HEIGHT, WIDTH), 255, dtype=np.uint8)
    x, y = facing[0].pixels(masked.xyz(walls)[None])[0].astype(int)
    covered[y - 120 : y + 120, x - 120 : x + 120] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), covered)
    evidence = ExclusionEvidence(
        tie_points=triangulate_tie_points(tracks, posed), masks={facing[0].name: tmp_path / "mask.png"}
    )
    rows = exclude_observations(seen, table, posed, model.elements, surface, evidence, ExclusionSettings()).to_pylist()

    outcome = {row["detection_id"]: row["observation_outcome"] for row in rows}
    assert set(outcome.values()) == {str(word) for word in ObservationOutcome}, outcome
    assert (outcome["sky"], outcome["outside"], outcome["lost"]) == ("off_target", "outside", "unlocalised")
    assert outcome["flat.jpg#far"] == "grazing"
    assert outcome[f"{facing[0].name}#masked"] == "masked"
    assert outcome[f"{facing[1].name}#masked"] == "registered"
    straight = f"{facing[2].name}#hidden"
    assert outcome[straight] == "occluded"
    (hidden,) = (row for row in rows if row["detection_id"] == straight)
    assert hidden["occluder_gap_m"] == pytest.approx(2.0, rel=0, abs=0.2)  # m
    assert all(outcome[f"{shot.name}#plain"] == "registered" for shot in facing)
    assert all(row["reason"] for row in rows if row["observation_outcome"] != "registered")
