"""Truth files of a campaign: cameras, check points, detections and states; and its control points."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import ModelError
from facadelake.demo.building.placement import DemoPlacement
from facadelake.demo.building.solids import Solid
from facadelake.demo.history import ImagedDefect, derive_track_state
from facadelake.demo.photographs.annotations import BoxAnnotation
from facadelake.demo.photographs.flight import DemoExposure
from facadelake.demo.photographs.visibility import DefectGrid, project_defect, sample_defect
from facadelake.demo.textures.defects import make_target
from facadelake.demo.textures.lighting import RayScene
from facadelake.demo.world import DemoWorld

SURVEY_SIGMA_M = 0.003
MARK_SIGMA_PX = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class HostElement:
    """The element of the model that a defect lies on, and the distance of the defect's centre from its surface."""

    solid: Solid
    distance_m: float


def find_host_element(world: DemoWorld, grid: DefectGrid, model_rays: RayScene) -> HostElement:
    """The element that a ray from in front of the wall hits; raises ModelError where a defect is not on the model."""
    start, normal = grid.xyz_site[:1] + 0.3 * grid.normals[:1], grid.normals[:1]
    hit, group = model_rays.cast(start, -normal)
    if group[0] < 0 or abs(hit[0] - 0.3) > 0.1:
        defect = grid.defect
        raise ModelError(
            f"defect {defect.id} at u {defect.u_m}, v {defect.v_m} of '{defect.surface}' is not on a wall; "
            "move it in the recipe"
        )
    return HostElement(solid=world.ifc[int(group[0])], distance_m=abs(float(hit[0]) - 0.3))


def _write_csv(path: Path, header: str, rows: Sequence[Sequence[object]]) -> None:
    """Write rows under a comma-separated header."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header.split(","))
        writer.writerows(rows)


def _format_geo(placement: DemoPlacement, xyz: Float64Array) -> list[str]:
    """Longitude, latitude and ellipsoidal height of a point (3,) in site, as text."""
    lon, lat, height = placement.origin.geo_from_site(xyz[None])[0]
    return [f"{lon:.10f}", f"{lat:.10f}", f"{height:.6f}"]


def write_cameras(path: Path, exposures: Sequence[DemoExposure], placement: DemoPlacement) -> None:
    """``cameras.csv``: intrinsics, rotation ``cam_from_site`` and centre of every photograph."""
    header = "image,fx_px,fy_px,cx_px,cy_px," + ",".join(f"cam_from_site_r{i}{j}" for i in range(3) for j in range(3))
    rows = []
    for exposure in exposures:
        c, centre = exposure.posed.camera, exposure.posed.centre_site_m
        rotation = exposure.posed.site_from_cam.rotation.T.ravel()
        row = [exposure.file_name, c.fx_px, c.fy_px, c.cx_px, c.cy_px, *(f"{x:.9f}" for x in rotation)]
        rows.append([*row, *(f"{x:.5f}" for x in centre), *_format_geo(placement, centre), c.k1, c.k2, c.p1, c.p2])
    _write_csv(path, header + ",x_site_m,y_site_m,z_site_m,lon_deg,lat_deg,height_ellipsoidal_m,k1,k2,p1,p2", rows)


def write_checkpoints(
    path: Path,
    grids: Sequence[DefectGrid],
    hosts: dict[str, HostElement],
    seen: dict[str, int],
    placement: DemoPlacement,
) -> None:
    """``checkpoints.csv``: the defects visible in a campaign's photographs, with true positions.

    Args:
        path: the file to write.
        grids: the defects present on the day of the campaign.
        hosts: element of each defect, by its id.
        seen: number of photographs that show each defect, by its id; others are left out.
        placement: georeference of the model.
    """
    header = (
        "id,class,x_site_m,y_site_m,z_site_m,lon_deg,lat_deg,height_ellipsoidal_m,width_m,height_m,photographs,"
        "max_residual_px,distance_to_model_m,element_guid,element_name,storey"
    )
    rows = []
    for grid in grids:
        d, host = grid.defect, hosts[grid.defect.id]
        if seen.get(d.id):
            place = [*(f"{x:.5f}" for x in grid.centre), *_format_geo(placement, grid.centre)]
            size, element = [round(d.width_m, 4), round(d.height_m, 4)], host.solid
            quality = [seen[d.id], 0.0, round(host.distance_m, 5)]
            rows.append([d.id, d.kind, *place, *size, *quality, element.guid, element.name, element.storey])
    _write_csv(path, header, rows)


def write_detections(path: Path, files: dict[str, Sequence[BoxAnnotation]]) -> None:
    """``detections.csv``: the check point that each annotation of each file shows."""
    rows = [(name, i, box.checkpoint_id) for name, boxes in files.items() for i, box in enumerate(boxes, start=1)]
    _write_csv(path, "file,annotation_id,checkpoint_id", sorted(rows, key=lambda r: (r[1], r[0])))


def observe_state(state: str, photographs: int) -> str:
    """The state that photographs can show: "not_photographed" for a place without photographs, else the true one."""
    return "not_photographed" if photographs == 0 else state


def write_defects(
    path: Path,
    world: DemoWorld,
    histories: dict[str, list[ImagedDefect]],
    hosts: dict[str, HostElement],
    imaged: dict[str, int],
    placement: DemoPlacement,
) -> None:
    """``defects.csv``: state, class, size and position of every defect of the recipe on the day of a campaign.

    ``true_state`` is the recipe's, ``state`` what photographs can show of it, and ``track_state`` what the campaigns
    until that day say together (``facadelake.demo.history`` has the rule). ``class``, ``width_m`` and ``height_m`` are
    those of that day; a defect that is not there has no size.

    Args:
        path: the file to write.
        world: the recipe and its surfaces.
        histories: the defects of the recipe on the days of this and of earlier campaigns, by id.
        hosts: element of each defect, by its id.
        imaged: number of photographs of each defect's place, whether or not the defect is present, by its id.
        placement: georeference of the model.
    """
    header = (
        "id,class,state,true_state,width_m,height_m,surface,u_m,v_m,x_site_m,y_site_m,z_site_m,lon_deg,lat_deg,"
        "height_ellipsoidal_m,photographs_of_place,element_guid,element_name,storey,track_state"
    )
    rows = []
    for name, history in histories.items():
        d, solid = history[-1].day, hosts[name].solid
        size = [round(d.width_m, 4), round(d.height_m, 4)] if d.exists else [0.0, 0.0]
        centre = sample_defect(world, d).centre
        photographs = imaged.get(name, 0)
        states = [observe_state(d.state, photographs), d.state]
        place = [d.surface, d.u_m, d.v_m, *(f"{x:.5f}" for x in centre), *_format_geo(placement, centre)]
        element = [photographs, solid.guid, solid.name, solid.storey]
        rows.append([d.id, d.kind, *states, *size, *place, *element, derive_track_state(history)])
    _write_csv(path, header, rows)


def write_control_points(
    path: Path,
    world: DemoWorld,
    exposures: Sequence[DemoExposure],
    rays: RayScene,
    placement: DemoPlacement,
    rng: np.random.Generator,
) -> None:
    """``gcp_list.txt`` in OpenDroneMap's format: surveyed control points with their image marks.

    Args:
        path: the file to write.
        world: the recipe and its surfaces.
        exposures: the photographs of the campaign.
        rays: the scene, for occlusions.
        placement: georeference of the model.
        rng: draws the errors of survey and marking.
    """
    lines = [placement.crs]
    for point in world.recipe.control_points:
        grid = sample_defect(world, make_target(point))
        surveyed = placement.origin.map_from_site(grid.xyz_site[:1], placement.crs)[0] + rng.normal(
            scale=SURVEY_SIGMA_M, size=3
        )
        for exposure in exposures:
            projection = project_defect(grid, exposure, rays)
            if projection and projection.incidence_deg < 60:
                x, y = projection.centre_px + rng.normal(scale=MARK_SIGMA_PX, size=2)
                east, north, height = surveyed
                lines.append(f"{east:.4f} {north:.4f} {height:.4f} {x:.2f} {y:.2f} {exposure.file_name} {point.id}")
    path.write_text("\n".join(lines) + "\n")
