"""One row a defect from its sightings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely

from facadelake.frames import Array
from facadelake.geobim.facade import COMPASS
from facadelake.geobim.model import BuildingModel
from facadelake.register.gate import Sightings
from facadelake.register.position import position_of, robust_mean
from facadelake.register.settings import MergeSettings

Row = dict[str, Any]


def defect_row(
    seen: Sequence[Row],
    sightings: Sightings,
    group: Sequence[int],
    scores: Mapping[str, float],
    elements: Mapping[str, Row],
    settings: MergeSettings,
) -> Row:
    """The defect of ``seen`` (rows of ``observations``; ``group`` in ``sightings``), without its id and globe."""
    index = np.asarray(group)
    quality = np.array([np.cos(np.radians(row["incidence_deg"])) / row["gsd_mm"] for row in seen])
    hits, weights = sightings.xyz_site_m[index], quality**2
    nearest = int(np.argmin(np.linalg.norm(hits - robust_mean(hits, weights), axis=1)))
    normal = sightings.normal_site[index[nearest]]
    extent = np.hypot(sightings.width_m[index], sightings.height_m[index])
    # Where the campaign itself may be off, its rays cross off the wall together: then the surface is the better word.
    sigma = np.hypot(settings.centre_share * extent, np.hypot(settings.floor_m, settings.offset_m))
    xyz = position_of(hits, sightings.ray_site[index], sigma, weights, normal, settings.relief_m)
    gaps = np.linalg.norm(hits - xyz, axis=1)
    best = seen[max(range(len(seen)), key=lambda i: (quality[i], seen[i]["photo_id"]))]
    guid = _most([row["element_guid"] for row in seen], quality)
    own = [i for i, row in enumerate(seen) if row["element_guid"] == guid]
    of_element = [seen[i] for i in own]
    element = elements[guid]
    return {
        "defect_class": seen[0]["defect_class"],
        "severity": "ungraded",
        "severity_rule": "none",
        **dict(zip(("x_site_m", "y_site_m", "z_site_m"), map(float, xyz), strict=True)),
        **dict(zip(("normal_x", "normal_y", "normal_z"), map(float, normal), strict=True)),
        **{name: float(np.median([row[name] for row in seen])) for name in ("width_m", "height_m", "area_m2")},
        "spread_m": float(gaps.max()),
        "sightings": len(seen),
        "score": max(float(scores[row["detection_id"]]) for row in seen),
        "best_photo_id": best["photo_id"],
        "element_guid": guid,
        "ifc_class": element["ifc_class"],
        "element_name": element["element_name"],
        "material": element["material"],
        "storey": _most([row["storey"] for row in of_element], quality[own]),
        "facade": _most([row["facade"] for row in of_element], quality[own]),
    }


def on_the_globe(defects: Sequence[Row], building: BuildingModel) -> list[Row]:
    """The defects with their places in EPSG:4979 and on the map, all converted at once."""
    xyz = np.array([[d["x_site_m"], d["y_site_m"], d["z_site_m"]] for d in defects]).reshape(-1, 3)
    if len(xyz) == 0:
        return []
    geo, on_map = building.origin.geo_from_site(xyz), building.map_from_site(xyz)
    points = shapely.to_wkb(shapely.points(geo), output_dimension=3)
    return [
        {
            **defect,
            **dict(zip(("lon_deg", "lat_deg", "height_ellipsoidal_m"), map(float, geo[i]), strict=True)),
            **dict(zip(("east_map_m", "north_map_m", "height_map_m"), map(float, on_map[i]), strict=True)),
            "geometry": points[i],
        }
        for i, defect in enumerate(defects)
    ]


def in_stable_order(defects: Sequence[Row]) -> list[int]:
    """Indices of the defects by facade, storey from the top, then along the facade as seen from outside, and height."""
    level = {}
    for storey in {defect["storey"] for defect in defects}:
        level[storey] = float(np.median([d["z_site_m"] for d in defects if d["storey"] == storey]))
    facades = [*COMPASS, *sorted({defect["facade"] for defect in defects} - set(COMPASS))]

    def place(index: int) -> tuple[Any, ...]:
        defect = defects[index]
        number = facades.index(defect["facade"])
        angle = np.radians(45.0 * number) if number < len(COMPASS) else 0.0
        # Who stands before a wall that faces north has west to the right.
        along = -np.cos(angle) * defect["x_site_m"] + np.sin(angle) * defect["y_site_m"]
        return (
            number,
            -level[defect["storey"]],
            str(defect["storey"]),
            round(float(along), 3),
            -round(defect["z_site_m"], 3),
            defect["defect_class"],
            defect["best_photo_id"],
        )

    return sorted(range(len(defects)), key=place)


def _most(words: Sequence[Any], weights: Array) -> Any:
    """The commonest word; of equally common ones the one with more weight, then the first by name."""
    total: dict[Any, tuple[int, float]] = {}
    for word, weight in zip(words, weights, strict=True):
        count, sum_ = total.get(word, (0, 0.0))
        total[word] = (count + 1, sum_ + float(weight))
    return min(total, key=lambda word: (-total[word][0], -total[word][1], str(word)))
