"""Deduplication by number of observations: time, CPU time and its growth, memory and pairwise F1, on synthetic data.

    .venv/bin/python -m benchmarks.merging [--sizes 10000 100000 1000000] [--stages]

A wall has one defect per square metre, half of them in pairs of one class 20 cm apart. It is photographed from 12 m in
three rows; each defect is observed three to ten times, with errors of boxes, poses, relief and classes.
"""

from __future__ import annotations

import argparse
import logging
import resource
import time
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import shapely

from facadelake.building import BuildingModel
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import get_stage_schema, table_from_rows
from facadelake.deduplication import MergeResult, merge_observations
from schemas.vocabulary import DefectClass, DetectionOutcome, ObservationOutcome

_HEIGHT_M = 20.0
_STANDOFF_M = 12.0
_STEP_M = 3.0  # between photographs, along the wall and upward
_CAMERA = Camera(width_px=8000, height_px=6000, fx_px=8000, fy_px=8000, cx_px=4000, cy_px=3000)
_TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # site_from_cam of a camera that faces north
_JITTER, _POSE_M, _RELIEF_M, _WRONG_CLASS = 0.03, 0.005, 0.03, 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticCampaign:
    """Tables, building and cameras of a synthetic campaign; ``defect`` (n,) is the true defect of each observation."""

    observations: pa.Table
    detections: pa.Table
    building: BuildingModel
    posed: dict[str, PosedCamera]
    defect: Int64Array


def generate_campaign(observations: int, seed: int = 1) -> SyntheticCampaign:
    """Generate a campaign of about ``observations`` observations."""
    rng = np.random.default_rng(seed)
    count = max(4, round(observations / 6.5))
    length = count / _HEIGHT_M
    x, z = rng.uniform(0, length, count), rng.uniform(0, _HEIGHT_M, count)
    kind = rng.integers(0, len(DefectClass), count)
    half = count // 4
    angle = rng.uniform(0, 2 * np.pi, half)
    x[half : 2 * half], z[half : 2 * half] = x[:half] + 0.2 * np.cos(angle), z[:half] + 0.2 * np.sin(angle)
    kind[half : 2 * half] = kind[:half]
    size = rng.uniform(0.1, 0.25, (count, 2))
    relief = rng.normal(0, _RELIEF_M, count)
    columns, rows = max(8, int(length / _STEP_M) + 5), 3
    centres = np.stack(
        np.meshgrid(np.arange(columns) * _STEP_M - 6, [-_STANDOFF_M], 4.0 + 6 * np.arange(rows), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    views = rng.integers(3, 11, count)
    defect = np.repeat(np.arange(count), views)
    # Each defect is in some of the twelve photographs of the nearest four columns.
    first = np.clip(np.round((x + 6) / _STEP_M).astype(np.int64) - 2, 0, columns - 4)
    choice = rng.permuted(np.tile(np.arange(12), (count, 1)), axis=1)
    rank = np.arange(len(defect)) - np.repeat(np.cumsum(views) - views, views)
    photo = first[defect] * rows + choice[defect, rank]
    real = np.column_stack([x, -relief, z])[defect]
    ray = real + rng.normal(0, _POSE_M, (len(defect), 3)) - centres[photo]
    ray[:, [0, 2]] += rng.normal(0, _JITTER, (len(defect), 2)) * size[defect]
    hit = centres[photo] + ray * (_STANDOFF_M / ray[:, 1])[:, None]
    seen = np.where(rng.random(len(defect)) < _WRONG_CLASS, (kind[defect] + 1) % len(DefectClass), kind[defect])
    return SyntheticCampaign(
        observations=_create_observations(hit, centres[photo], photo, seen, size[defect], rng),
        detections=_create_detections(len(defect)),
        building=_create_wall(length),
        posed={
            f"p{i:06d}": PosedCamera(camera=_CAMERA, site_from_cam=Similarity(rotation=_TURN, translation=centre))
            for i, centre in enumerate(centres)
        },
        defect=defect,
    )


def _format_identifiers(letter: str, numbers: Int64Array) -> pa.Array:
    return pa.array(np.char.add(letter, np.char.zfill(numbers.astype(str), 7)).tolist())


def _create_table(name: str, count: int, values: dict[str, pa.Array | Float64Array]) -> pa.Table:
    schema = get_stage_schema(name)
    return pa.table(
        [pa.array(values[f.name]).cast(f.type) if f.name in values else pa.nulls(count, f.type) for f in schema],
        schema=pa.schema([pa.field(f.name, f.type) for f in schema]),
    )


def _repeat(value: str, count: int) -> pa.Array:
    return pa.array([value]).take(pa.array(np.zeros(count, dtype=np.int64)))


def _create_observations(
    hit: Float64Array,
    centre_m: Float64Array,
    photo: Int64Array,
    kind: Int64Array,
    size: Float64Array,
    rng: np.random.Generator,
) -> pa.Table:
    count = len(hit)
    extent = size * rng.normal(1, _JITTER, size.shape)
    distance = np.linalg.norm(hit - centre_m, axis=1)
    square = shapely.to_wkb(shapely.box(9.0, 48.0, 9.00001, 48.00001))
    low = hit[:, 2] < _HEIGHT_M / 2
    values = {
        "detection_id": _format_identifiers("d", rng.permutation(count)),
        "photo_id": pa.array([f"p{i:06d}" for i in range(int(photo.max()) + 1)]).take(pa.array(photo)),
        "observation_outcome": _repeat(str(ObservationOutcome.REGISTERED), count),
        "defect_class": pa.array([str(value) for value in DefectClass]).take(pa.array(kind)),
        **{f"{axis}_site_m": hit[:, i] for i, axis in enumerate("xyz")},
        "normal_x": np.zeros(count),
        "normal_y": np.full(count, -1.0),
        "normal_z": np.zeros(count),
        "incidence_deg": np.degrees(np.arccos(np.clip(_STANDOFF_M / distance, 0, 1))),
        "distance_m": distance,
        "gsd_mm": 1000 * _STANDOFF_M / np.full(count, _CAMERA.fx_px),
        "width_m": extent[:, 0],
        "height_m": extent[:, 1],
        "length_m": np.hypot(extent[:, 0], extent[:, 1]),
        "area_m2": extent.prod(axis=1),
        "target_share": np.ones(count),
        "element_guid": pa.array(["high", "low"]).take(pa.array(low.astype(np.int64))),
        "storey": pa.array(["First floor", "Ground floor"]).take(pa.array(low.astype(np.int64))),
        "facade": _repeat("S", count),
        "patch": pa.array([square]).take(pa.array(np.zeros(count, dtype=np.int64))),
    }
    return _create_table("observations", count, values)


def _create_detections(count: int) -> pa.Table:
    values = {
        "detection_id": _format_identifiers("d", np.arange(count)),
        "detection_outcome": _repeat(str(DetectionOutcome.ACCEPTED), count),
        "score": np.ones(count),
    }
    return _create_table("detections", count, values)


def _create_wall(length_m: float) -> BuildingModel:
    corners = np.array([[-9.0, 0, 0], [length_m + 9, 0, 0], [length_m + 9, 0, _HEIGHT_M], [-9.0, 0, _HEIGHT_M]])
    outline = shapely.to_wkb(shapely.box(9.0, 48.0, 9.001, 48.001))
    rows = [
        {
            "element_guid": guid, "ifc_class": "IfcWall", "facade": "S", "surface_area_m2": length_m * _HEIGHT_M,
            "triangles": 2, "geometry": outline,
        }
        for guid in ("low", "high")
    ]  # fmt: skip
    return BuildingModel(
        origin=SiteOrigin(lon_deg=9.0, lat_deg=48.0, height_ellipsoidal_m=300.0),
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        georeference_level="50",
        remarks="",
        vertices_site_m=corners,
        triangles=np.array([[0, 1, 2], [0, 2, 3]]),
        element_of_triangle=np.array([0, 1]),
        elements=table_from_rows("elements", rows),
    )


def score_pairs(result: MergeResult, defect: Int64Array) -> tuple[float, float, float]:
    """Pairwise precision, recall and F1 of the merged observations against the true ``defect`` (n,)."""
    found = result.observations.column("defect_id").combine_chunks().dictionary_encode().indices.to_numpy()

    def count_pairs(*codes: Int64Array) -> float:
        size = np.unique(np.stack(codes, axis=1), axis=0, return_counts=True)[1].astype(np.float64)
        return float((size * (size - 1) / 2).sum())

    both, decided, true = count_pairs(found, defect), count_pairs(found), count_pairs(defect)
    return both / decided, both / true, 2 * both / (decided + true)


def count_separated_pairs(result: MergeResult, defect: Int64Array) -> tuple[int, int]:
    """Number of pairs of defects 20 cm apart that were not merged, and number of all such pairs."""
    found = result.observations.column("defect_id").combine_chunks().dictionary_encode().indices.to_numpy()
    owners = np.unique(np.column_stack([found, defect]), axis=0)
    half = (int(defect.max()) + 1) // 4
    first, second = owners[owners[:, 1] < half], owners[(owners[:, 1] >= half) & (owners[:, 1] < 2 * half)]
    keys = set(zip(first[:, 0].tolist(), first[:, 1].tolist(), strict=True))
    joined = {d - half for f, d in second.tolist() if (f, d - half) in keys}
    return half - len(joined), half


def main() -> None:
    """Print a line for each number of observations on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[10_000, 100_000, 1_000_000], help="numbers of observations"
    )
    parser.add_argument("--stages", action="store_true", help="log the time of each stage")
    options = parser.parse_args()
    logging.basicConfig(
        level=logging.INFO if options.stages else logging.WARNING, format="%(relativeCreated)d %(message)s"
    )
    before: tuple[int, float] | None = None
    print("observations   defects  seconds   CPU s  slope    MiB      F1     20 cm apart")
    for size in options.sizes:
        campaign = generate_campaign(size)
        held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        start, busy = time.perf_counter(), time.process_time()
        result = merge_observations(
            campaign.observations, campaign.detections, campaign.building, campaign.posed, prefix="wall"
        )
        seconds, busy = time.perf_counter() - start, time.process_time() - busy
        count = len(campaign.defect)
        slope = np.log(busy / before[1]) / np.log(count / before[0]) if before else np.nan
        before = (count, busy)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        apart, pairs = count_separated_pairs(result, campaign.defect)
        print(
            f"{count:12,d} {len(result.defects):9,d} {seconds:8.1f} {busy:7.1f} {slope:6.2f} "
            f"{max(peak - held, 0):6.0f} {score_pairs(result, campaign.defect)[2]:7.4f} {apart:7,d}/{pairs:,d}",
            flush=True,
        )


if __name__ == "__main__":
    main()
