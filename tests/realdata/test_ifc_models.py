"""Real models: the castle against its surveyed check points, and four models that nobody here made."""

import csv
import json
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pyproj
import pytest
import shapely

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.ifc.meshes import mesh_elements, open_ifc
from facadelake.building.model import BuildingModel
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.tables import table_from_rows
from facadelake.deduplication.merge import MergeResult, merge_observations
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings

pytestmark = pytest.mark.realdata
XYZ = ("x_site_m", "y_site_m", "z_site_m")
GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def numbers(rows, names):
    return np.array([[float(row[name]) for name in names] for row in rows])


@dataclass(frozen=True, kw_only=True)
class Castle:
    """The castle with its published cameras as poses: what registration is at best."""

    building: BuildingModel
    surface: Surface
    posed: dict[str, PosedCamera]
    folder: Path

    def merged(self, file: str) -> MergeResult:
        """The boxes of ``file``, observed and merged."""
        coco = json.loads((self.folder / file).read_text())
        photo = {image["id"]: image["file_name"] for image in coco["images"]}
        kind = {category["id"]: category["name"] for category in coco["categories"]}
        detections = table_from_rows(
            "detections",
            [
                {
                    "detection_id": str(note["id"]), "photo_id": photo[note["image_id"]],
                    "detection_outcome": "accepted", "defect_class": kind[note["category_id"]],
                    "source_class": kind[note["category_id"]], "score": note["score"], "box_x_px": note["bbox"][0],
                    "box_y_px": note["bbox"][1], "box_width_px": note["bbox"][2], "box_height_px": note["bbox"][3],
                    "detector": f"coco:{file}", "detector_sha256": "0",
                }
                for note in coco["annotations"]
            ],
        )  # fmt: skip
        seen = observe_detections(detections, self.posed, self.building, self.surface, RegistrationSettings())
        return merge_observations(seen, detections, self.building, self.posed, prefix="castle")

    def truth(self, file: str) -> dict[str, str]:
        """Check point of each annotation, by id; off_target is none."""
        rows = rows_of(self.folder / "truth" / "detections.csv")
        return {row["annotation_id"]: row["checkpoint_id"] for row in rows if row["file"] == file}


@pytest.fixture(scope="module")
def castle(shared_data) -> Castle:
    folder = shared_data / "castle"
    building = load_ifc_building(folder / "castle.ifc", settings=IfcModelSettings())
    posed = {}
    for row in rows_of(folder / "truth" / "cameras.csv"):
        printed = numbers([row], [f"cam_from_site_r{i}{j}" for i in range(3) for j in range(3)]).reshape(3, 3)
        u, _, vt = np.linalg.svd(printed)  # printed to six digits: made orthonormal again
        fx, fy, cx, cy = numbers([row], ["fx_px", "fy_px", "cx_px", "cy_px"])[0]
        # The truth's site frame has another origin; both share the globe. Their axes differ by 0.0001 degrees.
        centre = building.origin.site_from_geo(numbers([row], GEO))[0]
        posed[row["image"]] = PosedCamera(
            camera=Camera(width_px=3072, height_px=2048, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy),
            site_from_cam=Similarity(rotation=(u @ vt).T, translation=centre),
        )
    return Castle(building=building, surface=Surface(building), posed=posed, folder=folder)


@pytest.fixture(scope="module")
def checkpoints(castle) -> dict[str, dict[str, str]]:
    return {row["id"]: row for row in rows_of(castle.folder / "truth" / "checkpoints.csv")}


def place_of(castle, checkpoint):
    return castle.building.origin.site_from_geo(numbers([checkpoint], GEO))[0]


def test_the_castle_stands_where_its_surveyor_measured_it(castle, checkpoints):
    """Whoever made the check points wrote down their distance to the model, in a frame of their own."""
    assert castle.building.map_crs == "EPSG:25832"
    assert castle.building.vertical_datum == "ellipsoidal"
    rows = list(checkpoints.values())
    places = castle.building.origin.site_from_geo(numbers(rows, GEO))
    expected = numbers(rows, ["distance_to_model_m"])[:, 0]
    np.testing.assert_allclose(castle.surface.measure_distance(places), expected, rtol=0, atol=0.0002)  # m


def test_the_castles_elements(castle):
    rows = castle.building.elements.to_pylist()
    assert Counter(row["ifc_class"] for row in rows) == {
        "IfcWall": 81, "IfcWindow": 19, "IfcDoor": 2, "IfcColumn": 2, "IfcSlab": 2,
    }  # fmt: skip
    assert {row["storey"] for row in rows} == {"Ground floor", "First floor", "Second floor"}
    assert all(row["material"] for row in rows if row["ifc_class"] != "IfcSlab")
    assert all(shapely.from_wkb(row["geometry"]).is_valid for row in rows)


@pytest.mark.parametrize(
    ("file", "registered", "mean_m", "median_m", "f1", "defect_median_m"),
    [
        # methods.md: mean 4.4 cm, median 2.9 is the ceiling of surface registration
        ("detections.coco.json", 925, (0.040, 0.048), (0.027, 0.032), (0.99, 1.0), (0.001, 0.006)),
        ("detections_noisy.coco.json", 842, (0.050, 0.062), (0.037, 0.048), (0.97, 1.0), (0.015, 0.030)),
    ],
)
def test_castle_registration_with_published_cameras(
    castle, checkpoints, file, registered, mean_m, median_m, f1, defect_median_m
):
    truth = castle.truth(file)
    result = castle.merged(file)
    seen = [row for row in result.observations.to_pylist() if row["observation_outcome"] == "registered"]
    assert len(seen) == registered
    on_target = [row for row in seen if truth[row["detection_id"]] != "off_target"]
    assert len(on_target) == len(seen)  # every false box lies where no modelled surface is
    places = np.array([place_of(castle, checkpoints[truth[row["detection_id"]]]) for row in on_target])
    error = np.linalg.norm(np.array([[row[name] for name in XYZ] for row in on_target]) - places, axis=1)
    assert mean_m[0] < error.mean() < mean_m[1]
    assert median_m[0] < np.median(error) < median_m[1]
    right = [row["element_guid"] == checkpoints[truth[row["detection_id"]]]["element_guid"] for row in on_target]
    assert 0.95 < np.mean(right) < 1.0
    assert f1[0] < pairwise_f1(on_target, truth) <= f1[1]

    of_defect = defaultdict(list)
    for row in on_target:
        of_defect[row["defect_id"]].append(truth[row["detection_id"]])
    positions = {row["defect_id"]: [row[name] for name in XYZ] for row in result.defects.to_pylist()}
    off = [
        np.linalg.norm(positions[name] - place_of(castle, checkpoints[Counter(shown).most_common(1)[0][0]]))
        for name, shown in of_defect.items()
    ]
    assert defect_median_m[0] < np.median(off) < defect_median_m[1]  # crossing rays beat the surface


def pairwise_f1(rows, truth):
    """F1 of "same defect" over all pairs of detections, counted pair by pair."""
    right = decided = true = 0
    for a, b in combinations(rows, 2):
        same = a["defect_id"] == b["defect_id"]
        really = truth[a["detection_id"]] == truth[b["detection_id"]]
        right, decided, true = right + (same and really), decided + same, true + really
    return 2 * right / (decided + true)


ELSEWHERE = IfcModelSettings(
    map_crs="EPSG:25832",
    vertical_datum="ellipsoidal",
    placement=MapPlacement(east_m=456639.0, north_m=5421033.0, height_m=178.0, rotation_deg=10.0),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "elements", "storeys", "extent_m"),
    [
        ("AC20-FZK-Haus", 82, {"Erdgeschoss", "Dachgeschoss"}, (14.8, 13.2, 6.5)),
        ("LargeBuilding", 114, {"Level 1", "Level 2"}, (53.3, 43.1, 8.2)),
        ("TallBuilding", 55, {"Level 1", "Level 2", "Level 4", "Level 5", "Level 6"}, (9.6, 9.6, 16.6)),
    ],
)
def test_models_without_a_georeference_need_the_registrys(shared_data, name, elements, storeys, extent_m):
    path = shared_data / "ifc" / name / f"{name}.ifc"
    with pytest.raises(GeoreferenceError, match="names no projected CRS"):
        load_ifc_building(path, settings=IfcModelSettings())
    building = load_ifc_building(path, settings=ELSEWHERE)
    rows = building.elements.to_pylist()
    assert len(rows) == elements
    assert {row["storey"] for row in rows} == storeys
    assert not {row["ifc_class"] for row in rows} & {"IfcSpace", "IfcOpeningElement", "IfcSite", "IfcAnnotation"}
    np.testing.assert_allclose(np.ptp(building.vertices_site_m, axis=0), extent_m, rtol=0, atol=0.1)  # m
    assert {"N", "S", "E", "W"} <= {row["facade"] for row in rows}
    # The model's axes are rotated by 10 degrees to the left of the grid's, which are 0.45 to the left of true north.
    turned = {row["facade"]: row["facade_azimuth_deg"] for row in rows if row["facade_azimuth_deg"] is not None}
    assert set(turned) == {"N", "S", "E", "W"}
    for name, azimuth in (("E", 79.55), ("S", 169.55), ("W", 259.55), ("N", 349.55)):
        np.testing.assert_allclose(turned[name], azimuth, rtol=0, atol=0.05)  # deg
    assert {row["storey_source"] for row in rows} <= {"containment", "host"}
    assert all(json.loads(row["properties"]) for row in rows if row["properties"])


@pytest.mark.slow
def test_fzk_house_by_latitude_longitude_and_true_north(shared_data):
    """49 6 1.566 N, 8 26 11.5404 E, true north 50 degrees clockwise of the model's y axis: refused unless accepted."""
    path = shared_data / "ifc" / "AC20-FZK-Haus" / "AC20-FZK-Haus.ifc"
    with pytest.raises(GeoreferenceError, match=r"LoGeoRef 20.*accept_level: 20"):
        load_ifc_building(path, settings=IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal"))
    building = load_ifc_building(path, settings=IfcModelSettings(vertical_datum="ellipsoidal", accept_level=20))
    assert (building.georeference_level, building.map_crs) == ("20", "EPSG:32632")
    assert "accuracy about 10 m, one sigma" in building.remarks
    zero = building.origin.site_from_geo(np.array([[8 + 26 / 60 + 11.5404 / 3600, 49 + 6 / 60 + 1.566 / 3600, 110.0]]))
    low, high = building.vertices_site_m.min(axis=0), building.vertices_site_m.max(axis=0)
    assert (zero[0, :2] > low[:2] - 1).all()  # m: the house is at its origin
    assert (zero[0, :2] < high[:2] + 1).all()
    azimuths = {row["facade_azimuth_deg"] for row in building.elements.to_pylist()} - {None}
    np.testing.assert_allclose(sorted(azimuths), [40.0, 130.0, 220.0, 310.0], rtol=0, atol=0.05)  # deg


@pytest.mark.slow
def test_duplex_by_its_ifc2x3_property_sets(shared_data):
    """The user guide's property sets are at the site; the conversion by hand, then pyproj, gives the same positions."""
    path = shared_data / "ifc" / "Duplex_A_georef" / "Duplex_A_georef.ifc"
    # EPSG:9897 counts heights from Luxembourg's NG95, whose geoid grid PROJ's wheel does not bring.
    with pytest.raises(GeoreferenceError, match="PROJ knows none whose area of use contains the place"):
        load_ifc_building(path, settings=IfcModelSettings())
    gnss = load_ifc_building(path, settings=IfcModelSettings(vertical_datum="ellipsoidal"))
    building = load_ifc_building(path, settings=IfcModelSettings(vertical_datum="ellipsoid of the CRS"))
    assert (building.map_crs, building.georeference_level) == ("EPSG:2169", "50")
    xyz = np.vstack([mesh.vertices_ifc_m for mesh in mesh_elements(open_ifc(path), deflection_m=0.001, workers=2)])
    c, s = 0.325568154457152, 0.945518575599318
    east, north = 76670.0 + c * xyz[:, 0] - s * xyz[:, 1], 77179.0 + s * xyz[:, 0] + c * xyz[:, 1]
    luxembourg = pyproj.Transformer.from_crs(pyproj.CRS("EPSG:2169").to_3d(), "EPSG:4979", always_xy=True)
    geo = np.column_stack(luxembourg.transform(east, north, 293.700012207031 + xyz[:, 2]))
    expected = building.origin.site_from_geo(geo)
    np.testing.assert_allclose(building.vertices_site_m, expected, rtol=0, atol=0.001)  # m
    # A GNSS height is above GRS 80, 48 m from the ellipsoid of Luxembourg's datum.
    heights_m = gnss.origin.geo_from_site(gnss.vertices_site_m)[:, 2]
    np.testing.assert_allclose(heights_m, 293.700012207031 + xyz[:, 2], rtol=0, atol=0.001)  # m
    assert len(building.elements) == 215
    rows = building.elements.to_pylist()
    brick = [row for row in rows if (row["element_name"] or "").startswith("Basic Wall:Exterior - Brick on Block")]
    outside = [json.loads(row["material_layers"])[0] for row in brick if row["facade"] in ("N", "E", "S", "W")]
    assert len(outside) >= 4
    assert all(layer == {"material": "Masonry - Brick", "thickness_m": 0.092} for layer in outside)
    # Half of the western foundation lies under a terrace, and its end does not.
    concrete = [
        row for row in rows if (row["element_name"] or "").startswith("Basic Wall:Foundation - Concrete (417mm)")
    ]
    assert sorted(row["facade"] for row in concrete) == ["E", "N", "S", "W"]
    hosts = {row["element_guid"]: row for row in rows}
    windows = [row for row in rows if row["ifc_class"] == "IfcWindow" and row["host_guid"] in hosts]
    assert len(windows) >= 10
    assert all(hosts[row["host_guid"]]["ifc_class"].startswith("IfcWall") for row in windows)


def test_the_registrys_vertical_datum_goes_before_the_ifcs(shared_data):
    """The castle's heights are ellipsoidal; called DHHN2016 they need a geoid grid, and are never left as they are."""
    with pytest.raises(GeoreferenceError, match="grid"):
        load_ifc_building(shared_data / "castle" / "castle.ifc", settings=IfcModelSettings(vertical_datum="EPSG:7837"))
