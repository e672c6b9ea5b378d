"""Triangles of the demo: those of the written IFC, so that model and photographs agree, and of the surroundings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import ifcopenshell
import ifcopenshell.geom
import ifcopenshell.util.element
import numpy as np
import trimesh

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import ModelError
from facadelake.demo.recipe import BoxVolume, Tree

# Chord error of the triangles of the round corner; with a radius of metres this is a few degrees per facet.
DEFLECTION_M = 0.0005
SCAFFOLD_LIFT_M, SCAFFOLD_BAY_M, SCAFFOLD_TUBE_M = 2.0, 1.6, 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """Triangles (n, 3, 3) of one element, in the model's frame; ``guid`` is empty for solids outside the model."""

    guid: str
    kind: str
    name: str
    storey: str
    triangles: Float64Array


def read_ifc_solids(path: Path) -> list[Solid]:
    """The triangles of every product of an IFC with a body; openings are cut out, spaces omitted."""
    model = ifcopenshell.open(str(path))
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    settings.set("mesher-linear-deflection", DEFLECTION_M)
    settings.set("mesher-angular-deflection", 0.05)
    iterator = ifcopenshell.geom.iterator(settings, model, 1, exclude=model.by_type("IfcOpeningElement"))
    if not iterator.initialize():
        raise ModelError(f"{path.name} has no geometry; write it again")
    solids = []
    for shape in _read_shapes(iterator):
        element = model.by_guid(shape.guid)
        container = ifcopenshell.util.element.get_container(element)
        vertices = np.asarray(shape.geometry.verts, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(shape.geometry.faces, dtype=np.int64).reshape(-1, 3)
        solids.append(
            Solid(
                guid=shape.guid,
                kind=element.is_a(),
                name=element.Name or "",
                storey=(container.Name or "") if container else "",
                triangles=vertices[faces],
            )
        )
    return sorted(solids, key=lambda s: s.guid)


def _read_shapes(iterator: ifcopenshell.geom.iterator) -> Iterator[ifcopenshell.geom.ShapeElementType]:
    """The shapes of an iterator of IfcOpenShell."""
    while True:
        yield iterator.get()
        if not iterator.next():
            return


def make_box_solid(box: BoxVolume) -> Solid:
    """An upright box outside the model."""
    mesh = trimesh.creation.box(bounds=np.array([box.origin_m, np.add(box.origin_m, box.size_m)]))
    return _make_solid(box.name, np.asarray(mesh.triangles))


def make_roof_solid(box: BoxVolume) -> Solid:
    """A gable roof on a box, with its ridge along the longer side and 0.4 m eaves."""
    (x, y, z), (dx, dy, dz) = box.origin_m, box.size_m
    e, top, rise = 0.4, z + dz, 0.32 * min(dx, dy)
    x0, x1, y0, y1 = x - e, x + dx + e, y - e, y + dy + e
    if dx >= dy:
        ridge = [(x0, (y0 + y1) / 2, top + rise), (x1, (y0 + y1) / 2, top + rise)]
    else:
        ridge = [((x0 + x1) / 2, y0, top + rise), ((x0 + x1) / 2, y1, top + rise)]
    hull = trimesh.convex.convex_hull(np.array([(x0, y0, top), (x1, y0, top), (x1, y1, top), (x0, y1, top), *ridge]))
    return _make_solid(f"{box.name} roof", np.asarray(hull.triangles))


def make_tree_solids(tree: Tree, rng: np.random.Generator) -> list[Solid]:
    """A trunk, and a crown of about five thousand leaves in clumps; the same state of ``rng`` gives the same tree."""
    foot = np.array(tree.foot_m)
    trunk = trimesh.creation.cylinder(radius=0.05 * tree.height_m / 2 + 0.03, height=tree.height_m * 0.55, sections=10)
    trunk.apply_translation(foot + np.array([0.0, 0.0, tree.height_m * 0.275]))
    centre = foot + np.array([0.0, 0.0, tree.height_m - tree.crown_m])
    clumps = rng.normal(size=(28, 3))
    clumps *= (0.68 * tree.crown_m * rng.uniform(0.4, 1.0, 28) / np.linalg.norm(clumps, axis=1))[:, None]
    spread = rng.normal(size=(5200, 3))
    spread *= (0.42 * tree.crown_m * rng.uniform(0.5, 1.0, 5200) / np.linalg.norm(spread, axis=1))[:, None]
    leaf_centres = centre + clumps[rng.integers(0, 28, 5200)] + spread
    leaves = leaf_centres[:, None, :] + rng.normal(scale=0.075, size=(5200, 3, 3))
    return [_make_solid("trunk", np.asarray(trunk.triangles)), _make_solid("crown", leaves)]


def make_bare_tree_solids(tree: Tree, rng: np.random.Generator) -> list[Solid]:
    """The trunk of a tree without leaves, and its branches with twigs, where the crown would be."""
    trunk, crown = make_tree_solids(tree, rng)
    foot = np.array(tree.foot_m)
    ends = crown.triangles.mean(axis=1)[::9]
    start = foot + np.outer(rng.uniform(0.35, 0.55, len(ends)), [0.0, 0.0, tree.height_m])
    # Twigs leave a bough on its way from the trunk to the crown, so that they bundle towards the trunk.
    bough = np.array([0.0, 0.0, 1.0]) * tree.crown_m
    middle = start + 0.45 * (ends - start) + 0.12 * bough
    across = rng.normal(size=(len(ends), 3))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    lower = np.stack([start - 0.022 * across, start + 0.022 * across, middle], axis=1)
    upper = np.stack([middle - 0.011 * across, middle + 0.011 * across, ends], axis=1)
    return [trunk, _make_solid("branches", np.concatenate([lower, upper]))]


def make_scaffold_solids(box: BoxVolume) -> list[Solid]:
    """Frame and decks of a scaffold whose sheeted part is ``box``: standards, and one lift without sheeting on top."""
    low, size = np.array(box.origin_m), np.array(box.size_m)
    high = low + size
    top = high[2] + SCAFFOLD_LIFT_M
    half = SCAFFOLD_TUBE_M / 2
    inset = low[:2] + half, high[:2] - half
    along = int(np.argmax(size[:2]))
    bays = max(1, round(size[along] / SCAFFOLD_BAY_M))
    tubes = []
    for place in np.linspace(inset[0][along], inset[1][along], bays + 1):
        for side in (inset[0][1 - along], inset[1][1 - along]):
            foot = np.array([place, side] if along == 0 else [side, place])
            tubes.append(_make_bar(np.array([*foot, 0.0]), np.array([*foot, top + 0.3]), half))
    for z in (high[2] + 0.5, high[2] + 1.0, top, top + 0.25):
        for side in (inset[0][1 - along], inset[1][1 - along]):
            ends = [np.array([place, side] if along == 0 else [side, place]) for place in (low[along], high[along])]
            tubes.append(_make_bar(np.array([*ends[0], z]), np.array([*ends[1], z]), half))
    deck = trimesh.creation.box(bounds=np.array([[*low[:2], top - 0.05], [*high[:2], top]]))
    return [
        _make_solid(f"{box.name} frame", np.concatenate(tubes)),
        _make_solid(f"{box.name} deck", np.asarray(deck.triangles)),
    ]


def _make_bar(start: Float64Array, end: Float64Array, half_m: float) -> Float64Array:
    """Triangles (12, 3, 3) of a bar along an axis, with a square section of twice ``half_m``."""
    bar = trimesh.creation.box(bounds=np.array([np.minimum(start, end) - half_m, np.maximum(start, end) + half_m]))
    return np.asarray(bar.triangles, dtype=np.float64)


def make_ground_solid(half_m: float, centre: tuple[float, float], level_m: float) -> Solid:
    """A horizontal square."""
    x, y = centre
    a, b, c, d = ((x + sx * half_m, y + sy * half_m, level_m) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return _make_solid("ground", np.array([[a, b, c], [a, c, d]], dtype=np.float64))


def _make_solid(name: str, triangles: Float64Array) -> Solid:
    """A solid outside the model."""
    return Solid(guid="", kind="", name=name, storey="", triangles=np.asarray(triangles, dtype=np.float64))


def subdivide(triangles: Float64Array, edge_m: float) -> Float64Array:
    """The triangles cut until no edge is longer than ``edge_m`` (light is computed once per triangle)."""
    n = len(triangles)
    vertices, faces = trimesh.remesh.subdivide_to_size(
        triangles.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3), max_edge=edge_m, max_iter=20
    )
    return np.asarray(np.asarray(vertices, dtype=np.float64)[np.asarray(faces)])
