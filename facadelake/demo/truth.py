"""Truth files of a campaign: cameras, check points, which box shows what, states; and control points."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import ModelError
from facadelake.demo.building.placement import ModelPlacement
from facadelake.demo.building.solids import Solid
from facadelake.demo.photographs.annotations import BoxAnnotation
from facadelake.demo.photographs.flight import DemoExposure
from facadelake.demo.photographs.visibility import DefectGrid, project_defect, sample_defect
from facadelake.demo.recipe import DefectState, DemoControlPoint, DemoDefect
from facadelake.demo.textures.defects import compute_size
from facadelake.demo.textures.lighting import RayScene
from facadelake.demo.world import DemoWorld

SURVEY_SIGMA_M = 0.003
MARK_SIGMA_PX = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class HostElement:
    """The element of the model that a defect sits on, and how far off the model's surface its centre is."""

    solid: Solid
    distance_m: float


def find_host_element(world: DemoWorld, spot: DefectGrid, model_rays: RayScene) -> HostElement:
    """The element met by a ray from before the wall; raises ModelError where a recipe puts a defect into the air."""
    start, normal = spot.xyz_site[:1] + 0.3 * spot.normals[:1], spot.normals[:1]
    hit, group, _ = model_rays.cast(start, -normal)
    if group[0] < 0 or abs(hit[0] - 0.3) > 0.1:
        d = spot.defect
        raise ModelError(
            f"defect {d.id} at u {d.u_m}, v {d.v_m} of '{d.surface}' does not lie on the wall; move it in the recipe"
        )
    return HostElement(solid=world.ifc[int(group[0])], distance_m=abs(float(hit[0]) - 0.3))


def _write_csv(path: Path, header: str, rows: Sequence[Sequence[object]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header.split(","))
        writer.writerows(rows)


def _format_geo(placement: ModelPlacement, xyz: Float64Array) -> list[str]:
    lon, lat, height = placement.origin.geo_from_site(xyz[None])[0]
    return [f"{lon:.10f}", f"{lat:.10f}", f"{height:.6f}"]


def write_cameras(path: Path, shots: Sequence[DemoExposure], placement: ModelPlacement) -> None:
    """Intrinsics, rotation ``cam_from_site`` and centre of every photograph."""
    header = "image,fx_px,fy_px,cx_px,cy_px," + ",".join(f"cam_from_site_r{i}{j}" for i in range(3) for j in range(3))
    rows = []
    for shot in shots:
        c, centre = shot.posed.camera, shot.posed.centre_site_m
        rotation = shot.posed.site_from_cam.rotation.T.ravel()
        row = [shot.file_name, c.fx_px, c.fy_px, c.cx_px, c.cy_px, *(f"{x:.9f}" for x in rotation)]
        rows.append([*row, *(f"{x:.5f}" for x in centre), *_format_geo(placement, centre), c.k1, c.k2, c.p1, c.p2])
    _write_csv(path, header + ",x_site_m,y_site_m,z_site_m,lon_deg,lat_deg,height_ellipsoidal_m,k1,k2,p1,p2", rows)


def write_checkpoints(
    path: Path,
    spots: Sequence[DefectGrid],
    homes: dict[str, HostElement],
    seen: dict[str, int],
    placement: ModelPlacement,
) -> None:
    """The defects that a campaign's photographs show, with true positions."""
    header = (
        "id,class,x_site_m,y_site_m,z_site_m,lon_deg,lat_deg,height_ellipsoidal_m,width_m,height_m,photographs,"
        "max_residual_px,distance_to_model_m,element_guid,element_name,storey"
    )
    rows = []
    for spot in spots:
        d, home = spot.defect, homes[spot.defect.id]
        if seen.get(d.id):
            width, height = compute_size(d, spot.state)
            place = [*(f"{x:.5f}" for x in spot.centre), *_format_geo(placement, spot.centre)]
            size, element = [round(width, 4), round(height, 4)], home.solid
            quality = [seen[d.id], 0.0, round(home.distance_m, 5)]
            rows.append([d.id, d.kind, *place, *size, *quality, element.guid, element.name, element.storey])
    _write_csv(path, header, rows)


def write_detections(path: Path, files: dict[str, Sequence[BoxAnnotation]]) -> None:
    """Which annotation of which file shows which check point."""
    rows = [(name, i, box.checkpoint_id) for name, boxes in files.items() for i, box in enumerate(boxes, start=1)]
    _write_csv(path, "file,annotation_id,checkpoint_id", sorted(rows, key=lambda r: (r[1], r[0])))


def observe_state(state: DefectState, photographs: int) -> str:
    """What the photographs can tell: a place that none of them shows is 'not_photographed', whatever became of it."""
    return "not_photographed" if photographs == 0 else state


def write_defects(
    path: Path,
    world: DemoWorld,
    index: int,
    homes: dict[str, HostElement],
    imaged: dict[str, int],
    placement: ModelPlacement,
) -> None:
    """Every defect of the recipe on the day of a campaign: what it is, what the photographs can tell, size and place.

    ``imaged`` counts photographs of the place, whether or not a defect is there to be seen.
    """
    header = (
        "id,class,state,true_state,width_m,height_m,surface,u_m,v_m,x_site_m,y_site_m,z_site_m,lon_deg,lat_deg,"
        "height_ellipsoidal_m,photographs_of_place,element_guid,element_name,storey"
    )
    rows = []
    for d in world.recipe.defects:
        state, solid = d.states[index], homes[d.id].solid
        gone = state in ("absent", "repaired")
        width, height = (0.0, 0.0) if gone else compute_size(d, state)
        centre = sample_defect(world, d, state).centre
        photographs = imaged.get(d.id, 0)
        known = [observe_state(state, photographs), state, round(width, 4), round(height, 4)]
        place = [d.surface, d.u_m, d.v_m, *(f"{x:.5f}" for x in centre), *_format_geo(placement, centre)]
        rows.append([d.id, d.kind, *known, *place, photographs, solid.guid, solid.name, solid.storey])
    _write_csv(path, header, rows)


def write_control_points(
    path: Path,
    world: DemoWorld,
    shots: Sequence[DemoExposure],
    rays: RayScene,
    placement: ModelPlacement,
    rng: np.random.Generator,
) -> None:
    """``gcp_list.txt`` in OpenDroneMap's format: surveyed targets, marked by hand in the photographs that show them."""
    lines = [placement.crs]
    for point in world.recipe.control_points:
        spot = _sample_target(world, point)
        surveyed = placement.origin.map_from_site(spot.xyz_site[:1], placement.crs)[0] + rng.normal(
            scale=SURVEY_SIGMA_M, size=3
        )
        for shot in shots:
            sighting = project_defect(spot, shot, rays)
            if sighting and sighting.incidence_deg < 60:
                x, y = sighting.centre_px + rng.normal(scale=MARK_SIGMA_PX, size=2)
                east, north, height = surveyed
                lines.append(f"{east:.4f} {north:.4f} {height:.4f} {x:.2f} {y:.2f} {shot.file_name} {point.id}")
    path.write_text("\n".join(lines) + "\n")


def _sample_target(world: DemoWorld, point: DemoControlPoint) -> DefectGrid:
    defect = DemoDefect(
        id=point.id,
        kind="crack",
        surface=point.surface,
        u_m=point.u_m,
        v_m=point.v_m,
        width_m=0.16,
        height_m=0.16,
        states=[],
    )
    return sample_defect(world, defect, "present")
