"""Ids of tracks: given once, kept by the same defect, never used again."""

from __future__ import annotations

import numpy as np

from facadelake.tracking.identity import (
    Chains,
    KnownTracks,
    assign_track_numbers,
    format_track_id,
    read_track_number,
)

NONE = KnownTracks(
    number=np.zeros(0, dtype=np.int64),
    xyz_site_m=np.zeros((0, 3)),
    reach_m=np.zeros(0),
    defect_class=np.zeros(0, dtype=np.int64),
    sightings={},
)


def chains(x_m: list[float], run_id: str = "r1", classes: list[int] | None = None) -> Chains:
    return Chains(
        xyz_site_m=np.array([[x, 0.0, 0.0] for x in x_m]).reshape(-1, 3),
        defect_class=np.array(classes or [0] * len(x_m), dtype=np.int64),
        sightings=[[("2026-04", run_id, f"D{k}")] for k in range(len(x_m))],
    )


def know(found: Chains, numbers: np.ndarray) -> KnownTracks:
    return KnownTracks(
        number=numbers,
        xyz_site_m=found.xyz_site_m,
        reach_m=np.full(len(numbers), 0.3),
        defect_class=found.defect_class,
        sightings={one: row for row, of_chain in enumerate(found.sightings) for one in of_chain},
    )


def test_the_first_ids_count_from_one() -> None:
    assert assign_track_numbers(NONE, chains([0.0, 5.0])).tolist() == [1, 2]
    assert format_track_id("castle", 42) == "castle-0042" and read_track_number("my-tower-12345") == 12345


def test_shared_detections_keep_the_id_whatever_the_order() -> None:
    first = chains([0.0, 5.0, 9.0])
    turned = Chains(
        xyz_site_m=first.xyz_site_m[::-1], defect_class=first.defect_class[::-1], sightings=first.sightings[::-1]
    )
    assert assign_track_numbers(know(first, np.array([1, 2, 3])), turned).tolist() == [3, 2, 1]


def test_a_campaign_inspected_anew_keeps_ids_by_place_and_class() -> None:
    known = know(chains([0.0, 0.1, 9.0], classes=[0, 1, 0]), np.array([1, 2, 3]))
    anew = chains([0.12, 0.02, 9.2, 20.0], run_id="r2", classes=[1, 0, 0, 0])
    assert assign_track_numbers(known, anew).tolist() == [2, 1, 3, 4]


def test_a_number_is_never_used_again() -> None:
    known = know(chains([0.0, 5.0]), np.array([3, 7]))
    assert assign_track_numbers(known, chains([20.0, 0.0], run_id="r2")).tolist() == [8, 3]
