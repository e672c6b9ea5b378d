"""The castle's IFC written as a mesh file: the same rays must meet it in the same places."""

from pathlib import Path

import numpy as np
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.mesh.load import MeshModelSettings, load_mesh_building
from facadelake.building.surface.raycasting import Surface

pytestmark = pytest.mark.realdata


def test_rays_meet_the_mesh_where_they_meet_the_ifc(shared_data: Path, tmp_path: Path) -> None:
    by_ifc = load_ifc_building(shared_data / "castle" / "castle.ifc", settings=IfcModelSettings())
    on_map = by_ifc.map_from_site(by_ifc.vertices_site_m)
    zero = np.floor(on_map.min(axis=0))
    with (tmp_path / "castle.obj").open("w") as stream:
        stream.writelines(f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in on_map - zero)
        stream.writelines(f"f {a} {b} {c}\n" for a, b, c in by_ifc.triangles + 1)
    (tmp_path / "castle_offset.xyz").write_text(" ".join(map(str, zero)))
    settings = MeshModelSettings(
        map_crs="EPSG:25832", vertical_datum="ellipsoidal", offset_file=tmp_path / "castle_offset.xyz"
    )
    by_mesh = load_mesh_building(tmp_path / "castle.obj", settings=settings)

    rng = np.random.default_rng(8)
    eyes = np.array([0.0, -8, 2]) + rng.normal(0, 2, (3000, 3))  # from the yard to all sides
    directions = rng.normal(0, 1, (3000, 3)) * [1, 1, 0.3]
    ifc_hits = Surface(by_ifc).cast(eyes, directions)
    globe = by_mesh.origin.ecef_from_site().invert() @ by_ifc.origin.ecef_from_site()
    mesh_hits = Surface(by_mesh).cast(globe.apply(eyes), globe.rotate(directions))
    both = ifc_hits.hit & mesh_hits.hit
    assert both.sum() > 1000 and (ifc_hits.hit == mesh_hits.hit).mean() > 0.999
    apart = np.linalg.norm(globe.apply(ifc_hits.xyz_site_m[both]) - mesh_hits.xyz_site_m[both], axis=1)
    assert np.quantile(apart, 0.995) < 0.001  # m; a ray along an edge may take either side of it
    facades = set(by_mesh.elements.column("facade").to_pylist())
    assert {"S", "E"} <= facades  # the main wall and the wing that face the yard
