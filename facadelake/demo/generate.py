"""The whole demo: model, photographs, annotations, control points and truth, complete or not at all."""

from __future__ import annotations

import json
import logging
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import uuid
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from filelock import FileLock

from facadelake.core.code_version import compute_code_version, require_unchanged_code
from facadelake.core.errors import FacadelakeError
from facadelake.core.hashing import compute_key
from facadelake.core.progress import report_progress
from facadelake.demo.building.ifc_writer import write_ifc
from facadelake.demo.building.placement import DemoPlacement, place_model
from facadelake.demo.building.solids import read_ifc_solids
from facadelake.demo.history import ImagedDefect, write_history
from facadelake.demo.photographs.annotations import (
    FALSE_SHARE,
    make_exact_boxes,
    make_false_boxes,
    make_noisy_boxes,
    write_coco,
)
from facadelake.demo.photographs.exif_writer import encode_exif, encode_xmp
from facadelake.demo.photographs.flight import DemoExposure, camera_from_optics, plan_flight
from facadelake.demo.photographs.render import PhotoJob, RenderJob
from facadelake.demo.photographs.visibility import project_defects, sample_defect
from facadelake.demo.recipe import CampaignRecipe, DemoRecipe
from facadelake.demo.scene import RenderScene, build_scene
from facadelake.demo.textures.lighting import RayScene
from facadelake.demo.truth import (
    HostElement,
    find_host_element,
    write_cameras,
    write_checkpoints,
    write_control_points,
    write_defects,
    write_detections,
)
from facadelake.demo.world import DemoWorld, make_world

logger = logging.getLogger(__name__)

MANIFEST = "demo.json"
RENDER_PROCESSES = 2


@dataclass(frozen=True, kw_only=True)
class DemoCampaign:
    """The folder of a campaign and that of its photographs."""

    campaign_id: str
    folder: Path
    images: Path


@dataclass(frozen=True, kw_only=True)
class DemoFiles:
    """The files of the demo; ``made`` is false where all of them existed already."""

    folder: Path
    ifc: Path
    campaigns: tuple[DemoCampaign, ...]
    made: bool


def generate_demo(recipe: DemoRecipe, out: Path) -> DemoFiles:
    """Generate the demo of a recipe in ``out``, or find it there complete.

    It is written to a temporary folder beside ``out`` that is renamed at the end, so an interrupted run leaves nothing
    incomplete.
    """
    key = compute_key({"recipe": recipe.model_dump(mode="json"), "code": compute_code_version(__name__).sha256})
    out = out.resolve()
    out.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(out.parent / f".{out.name}.lock"):
        if _is_complete(out, key):
            return _list_files(recipe, out, made=False)
        for abandoned in out.parent.glob(f".{out.name}.*.part"):
            shutil.rmtree(abandoned, ignore_errors=True)
        temporary = out.parent / f".{out.name}.{uuid.uuid4().hex[:8]}.part"
        try:
            _write_demo(recipe, temporary)
            require_unchanged_code(__name__)
            names = sorted(str(p.relative_to(temporary)) for p in temporary.rglob("*") if p.is_file())
            (temporary / MANIFEST).write_text(json.dumps({"key": key, "files": names}, indent=1))
            shutil.rmtree(out, ignore_errors=True)
            temporary.rename(out)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return _list_files(recipe, out, made=True)


def _is_complete(out: Path, key: str) -> bool:
    """Whether ``out`` holds all files of a demo with the same key."""
    try:
        stamp = json.loads((out / MANIFEST).read_text())
    except (OSError, ValueError):
        return False
    match stamp:
        case {"key": recorded, "files": list(names)} if recorded == key:
            return all(isinstance(name, str) and (out / name).is_file() for name in names)
    return False


def _list_files(recipe: DemoRecipe, out: Path, *, made: bool) -> DemoFiles:
    """The paths of the demo in ``out``."""
    folders = [(c.id, out / "campaigns" / c.id) for c in recipe.campaigns]
    campaigns = tuple(DemoCampaign(campaign_id=i, folder=f, images=f / "images") for i, f in folders)
    return DemoFiles(folder=out, ifc=out / "demo.ifc", campaigns=campaigns, made=made)


def _write_demo(recipe: DemoRecipe, out: Path) -> None:
    """Write model, campaigns and truth into the new folder ``out``."""
    out.mkdir(parents=True)
    placement = place_model(recipe.place)
    write_ifc(recipe, placement, out / "demo.ifc")
    world = make_world(recipe, placement.compute_affine(), read_ifc_solids(out / "demo.ifc"))
    model_rays = RayScene([world.transform_to_site(s.triangles) for s in world.ifc])
    hosts = {
        d.id: find_host_element(world, sample_defect(world, d.describe_place()), model_rays) for d in recipe.defects
    }
    histories: dict[str, list[ImagedDefect]] = {d.id: [] for d in recipe.defects}
    photographs = sum(c.flight.count_photographs() for c in recipe.campaigns)
    total = photographs + len(recipe.campaigns) * 4
    with report_progress("Demo building: model, light and photographs", total) as step:
        for index, campaign in enumerate(recipe.campaigns):
            folder = out / "campaigns" / campaign.id
            exposures = plan_flight(world, campaign, placement.origin.geo_from_site)
            scene = build_scene(world, campaign, index)
            step.advance(4)
            for _ in _render_campaign(recipe, campaign, placement, exposures, scene, folder / "images"):
                step.advance()
            _write_truth(world, campaign, index, placement, exposures, scene.rays, hosts, histories, folder)
            logger.info("campaign %s: %d photographs", campaign.id, len(exposures))
    write_history(recipe, out)


def _render_campaign(
    recipe: DemoRecipe,
    campaign: CampaignRecipe,
    placement: DemoPlacement,
    exposures: list[DemoExposure],
    scene: RenderScene,
    images: Path,
) -> Iterator[str]:
    """Render the photographs of a campaign in processes of their own; yields each name when it is ready."""
    jobs, optics = [], recipe.find_optics(campaign)
    for number, exposure in enumerate(exposures):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = exposure.posed.site_from_cam.rotation, exposure.posed.centre_site_m
        jobs.append(
            PhotoJob(
                path=images / exposure.file_name,
                site_from_cam=pose,
                exif=encode_exif(exposure, optics),
                xmp=encode_xmp(exposure, recipe.place.height_ellipsoidal_m),
                seed=campaign.seed * 1000 + number,
            )
        )
    with tempfile.TemporaryDirectory(prefix="facadelake-demo-") as name:
        folder = Path(name)
        for i, (texture, image) in enumerate(scene.textures.items()):
            parts = [part for part in scene.parts if part.texture == texture]
            np.save(folder / f"texture_{i:02d}.npy", image)
            triangles, uv, colours = (
                np.concatenate([getattr(p, k) for p in parts]) for k in ("triangles", "uv", "colours")
            )
            np.savez(folder / f"part_{i:02d}.npz", triangles=triangles, uv=uv, colours=colours)
        job = RenderJob(camera=camera_from_optics(optics), noise=campaign.light.noise, photographs=jobs)
        (folder / "job.pickle").write_bytes(pickle.dumps(job))
        yield from _run_renderers(folder, min(RENDER_PROCESSES, len(jobs)))


def _run_renderers(folder: Path, count: int) -> Iterator[str]:
    """Render the jobs of ``folder`` in ``count`` processes; yields the name of each photograph when it is ready."""
    environment = {**os.environ, "PYOPENGL_PLATFORM": "egl"}
    workers = []
    for shard in range(count):
        errors = (folder / f"errors_{shard}.txt").open("w+")
        command = [sys.executable, "-m", "facadelake.demo.photographs.render", str(folder), str(shard), str(count)]
        workers.append(
            (subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment), errors)
        )
    try:
        for worker, errors in workers:
            assert worker.stdout is not None
            yield from (line.strip() for line in worker.stdout)
            if worker.wait() != 0:
                errors.seek(0)
                last = errors.read().strip().splitlines()[-1:] or [f"exit code {worker.returncode}"]
                raise FacadelakeError(
                    f"rendering the photographs of the demo failed: {last[0]}; check with `facadelake doctor` whether "
                    "EGL works (Debian: apt-get install libegl1 libgl1 libegl-mesa0)"
                )
    finally:
        for worker, errors in workers:
            if worker.poll() is None:
                worker.kill()
                worker.wait()
            errors.close()


def _write_truth(
    world: DemoWorld,
    campaign: CampaignRecipe,
    index: int,
    placement: DemoPlacement,
    exposures: list[DemoExposure],
    rays: RayScene,
    hosts: dict[str, HostElement],
    histories: dict[str, list[ImagedDefect]],
    folder: Path,
) -> None:
    """Annotations, control points and truth of one campaign, which is appended to ``histories``."""
    recipe = world.recipe
    rng = np.random.default_rng([recipe.seed, campaign.seed, 7])
    days, off_target_days = (
        [d.describe_day(index) for d in defects] for defects in (recipe.defects, recipe.off_target_defects)
    )
    grids, off_target_grids = (
        [sample_defect(world, d) for d in defects if d.exists] for defects in (days, off_target_days)
    )
    projected = project_defects([*grids, *off_target_grids], exposures, rays)
    exact = make_exact_boxes(projected, {d.id for d in recipe.defects}, rng)
    false = make_false_boxes(round(FALSE_SHARE * len(exact)), exposures, rays, set(range(len(world.ifc))), rng)
    noisy = make_noisy_boxes(exact, false, exposures, rng)
    write_coco(folder / "detections.coco.json", exact, exposures)
    write_coco(folder / "detections_noisy.coco.json", noisy, exposures)
    if campaign.has_control_points:
        write_control_points(folder / "gcp_list.txt", world, exposures, rays, placement, rng)
    truth = folder / "truth"
    seen = Counter(s.grid.defect.id for s in projected)
    write_cameras(truth / "cameras.csv", exposures, placement)
    write_checkpoints(truth / "checkpoints.csv", grids, hosts, seen, placement)
    write_detections(truth / "detections.csv", {"detections.coco.json": exact, "detections_noisy.coco.json": noisy})
    place_grids = [sample_defect(world, d.describe_place()) for d in recipe.defects]
    imaged = Counter(s.grid.defect.id for s in project_defects(place_grids, exposures, rays))
    for day in days:
        photographs = seen[day.id] if day.exists else imaged[day.id]
        histories[day.id].append(ImagedDefect(day=day, photographs=photographs))
    write_defects(truth / "defects.csv", world, histories, hosts, imaged, placement)
