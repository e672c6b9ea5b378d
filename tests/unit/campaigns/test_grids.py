"""Grids that a registered building lacks, by the CRSs of its portfolio, IFC and control points."""

from pathlib import Path

from facadelake.campaigns import check_grids
from facadelake.doctor import Status, check_building_grids
from facadelake.registry import Building


def make_building(tmp_path: Path, crs: dict[str, object], header: str = "EPSG:25832") -> Building:
    """A building whose IFC names Gauss-Krueger zone 3, with control points in ``header``."""
    (tmp_path / "hall.ifc").write_text("#35= IFCPROJECTEDCRS('EPSG:31467','GK3',$,$,$,$,$);")
    (tmp_path / "gcp_list.txt").write_text(f"{header}\n456630.3 5421032.9 182.2 1 2 a.jpg G1\n")
    return Building.model_validate(
        {
            "id": "hall", "name": "Hall", "model": str(tmp_path / "hall.ifc"), "photographs": str(tmp_path),
            "campaigns": ["2026-04"], "control_points": str(tmp_path / "gcp_list.txt"), "crs": crs,
        }
    )  # fmt: skip


def test_the_grid_of_the_ifc_is_missing(tmp_path: Path) -> None:
    found = check_grids(make_building(tmp_path, {}))
    assert found.crs == ("EPSG:25832", "EPSG:31467")
    assert len(found.problems) == 1
    assert "needs the grid de_adv_BETA2007.tif, which is not installed: install it (apt install" in found.problems[0]
    check = check_building_grids(make_building(tmp_path, {}))
    assert (check.name, check.status) == ("transformation grids of hall", Status.WARNING)


def test_an_accepted_operation_needs_none(tmp_path: Path) -> None:
    assert check_grids(make_building(tmp_path, {"accept_operation_accuracy_m": 3})).problems == ()


def test_a_geoid_and_control_points_of_another_country(tmp_path: Path) -> None:
    crs = {"map": "EPSG:25832", "vertical": "EPSG:7837"}
    found = check_grids(make_building(tmp_path, crs, header="EPSG:27700"))
    assert [problem.split(".tif")[0].split(" ")[-1] for problem in found.problems] == [
        "de_bkg_gcg2016",
        "uk_os_OSTN15_NTv2_OSGBtoETRS",
    ]
