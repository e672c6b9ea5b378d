"""Building models that are invalid, truncated or not georeferenced: the whole message of each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.core.errors import FacadelakeError, GeoreferenceError, ModelError
from facadelake.registry.building import Building
from tests.unit.building.conftest import Box, Ifc

WriteIfc = Callable[[Ifc], Path]
CONVERSION = {"Eastings": 456639.25, "Northings": 5421033.5, "OrthogonalHeight": 178.25}
UTM = {"Name": "EPSG:25832"}
CRS = UTM | {"VerticalDatum": "ellipsoidal"}
PLACED = Ifc(crs=CRS, conversion=CONVERSION)
BY_IFC = IfcModelSettings()

STEP = (
    b"ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
    b"FILE_SCHEMA(('%s'));\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n"
)
NOT_STEP = "export it as .ifc (IFC2x3, IFC4 or IFC4.3), not zipped or as XML"
OTHER_SCHEMA = "export it again as IFC2x3, IFC4 or IFC4.3"


def refused(kind: type[FacadelakeError], path: Path, settings: IfcModelSettings = BY_IFC) -> str:
    with pytest.raises(kind) as raised:
        load_ifc_building(path, settings=settings)
    return str(raised.value)


@pytest.mark.parametrize("share", [0.3, 0.7, 0.999])
def test_a_truncated_model_is_refused_before_it_is_parsed(write_ifc: WriteIfc, share: float) -> None:
    """A truncated file parses without an error and lacks elements: half a building would be inspected."""
    path = write_ifc(PLACED)
    whole = path.read_bytes()
    size = int(share * len(whole))
    path.write_bytes(whole[:size])
    assert refused(ModelError, path) == (
        f"building model {path} is truncated: {size} bytes without the closing END-ISO-10303-21; copy or "
        "export it again"
    )
    path.write_bytes(whole)
    assert len(load_ifc_building(path, settings=BY_IFC).elements) == 1


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"", f"is not an IFC in STEP text: the file is empty, not ISO-10303-21; {NOT_STEP}"),
        (
            b"PK\x03\x04 zipped",
            f"is not an IFC in STEP text: it starts with b'PK\\x03\\x04 zipped', not ISO-10303-21; {NOT_STEP}",
        ),
        (
            b"<?xml version='1.0'?><ifc/>",
            f'is not an IFC in STEP text: it starts with b"<?xml version=\'1", not ISO-10303-21; {NOT_STEP}',
        ),
        (
            STEP % b"NONSENSE",
            f"is damaged or of an unknown schema (Unsupported schema: NONSENSE); {OTHER_SCHEMA}",
        ),
        (
            b"ISO-10303-21;\n\x00\xff\xfe garbage ((((\nEND-ISO-10303-21;\n",
            f"is damaged or of an unknown schema (Unable to parse IFC SPF header); {OTHER_SCHEMA}",
        ),
        (STEP % b"IFC4", "has no IfcProject; export the whole model, not a library or a part"),
    ],
    ids=["zero bytes", "zipped", "xml", "unknown schema", "garbage", "no project"],
)
def test_a_file_that_is_not_a_model(tmp_path: Path, content: bytes, what: str) -> None:
    path = tmp_path / "model.ifc"
    path.write_bytes(content)
    assert refused(ModelError, path) == f"building model {path} {what}"


def test_a_missing_model_and_one_without_bodies(tmp_path: Path, write_ifc: WriteIfc) -> None:
    path = tmp_path / "nothing.ifc"
    assert refused(ModelError, path) == (
        f"building model {path} cannot be read (No such file or directory); check the path of model in the portfolio"
    )
    assert refused(ModelError, write_ifc(Ifc(boxes=[], crs=CRS, conversion=CONVERSION))) == (
        "the building model has 0 elements with a body, and none of them could be meshed; "
        "export it with body geometry (design transfer or reference view)"
    )


VERTICAL = "set crs.vertical in the portfolio: 'ellipsoidal', or a vertical CRS such as EPSG:7837 (DHHN2016)"
SET_CRS = "set crs.map in the portfolio to an EPSG code such as EPSG:25832"
CHECK = "check the CRS and the units, and that the shift to the map is not in both the geometry and IfcMapConversion"
UNKNOWN_DATUM = "EPSG:99999"


@pytest.mark.parametrize(
    ("ifc", "settings", "message"),
    [
        (
            Ifc(),
            BY_IFC,
            "the IFC names no projected CRS (it has no IfcSite latitude and longitude either); "
            "add IfcProjectedCRS to it, or set crs.map in the portfolio, such as EPSG:25832",
        ),
        (
            Ifc(crs=CRS),
            BY_IFC,
            "the IFC is not georeferenced: it has no IfcMapConversion (it has no IfcSite latitude and longitude "
            "either); georeference it in the authoring tool, or set crs.placement "
            "(east_m, north_m, height_m, rotation_deg) in the portfolio",
        ),
        (
            Ifc(crs=UTM, conversion=CONVERSION),
            BY_IFC,
            f"neither the IFC nor the portfolio states the vertical datum of the model's heights (CRS EPSG:25832); "
            f"{VERTICAL}",
        ),
        (
            Ifc(crs=UTM | {"VerticalDatum": "castle zero"}, conversion=CONVERSION),
            BY_IFC,
            f"PROJ knows no single vertical CRS named 'castle zero'; {VERTICAL}",
        ),
        (
            Ifc(crs=UTM | {"VerticalDatum": UNKNOWN_DATUM}, conversion=CONVERSION),
            BY_IFC,
            f"PROJ knows no single vertical CRS named 'EPSG:99999'; {VERTICAL}",
        ),
        (
            PLACED,
            IfcModelSettings(vertical_datum=UNKNOWN_DATUM),
            f"PROJ knows no single vertical CRS named 'EPSG:99999'; {VERTICAL}",
        ),
        (
            PLACED,
            IfcModelSettings(vertical_datum="EPSG:25832"),
            "EPSG:25832 (ETRS89 / UTM zone 32N) is not a vertical CRS; use one such as EPSG:7837 (DHHN2016 height)",
        ),
        (
            PLACED,
            IfcModelSettings(vertical_datum="EPSG:7837"),
            "no transformation from ETRS89 / UTM zone 32N + DHHN2016 height to WGS 84 is available at lon 8.41, lat "
            "48.94: the grid de_bkg_gcg2016.tif of Inverse of ETRS89 to DHHN2016 height (1) + ETRS89 to WGS 84 (1) "
            "(1.1 m) is not installed; install it (pyproj sync --file de_bkg_gcg2016.tif), or convert the "
            "heights to ellipsoidal ones",
        ),
        (
            Ifc(crs=CRS | {"Name": "Ettlingen local"}, conversion=CONVERSION),
            BY_IFC,
            f"CRS 'Ettlingen local' is not known to PROJ; {SET_CRS}",
        ),
        (PLACED, IfcModelSettings(map_crs="EPSG:99999"), f"CRS 'EPSG:99999' is not known to PROJ; {SET_CRS}"),
        (
            PLACED,
            IfcModelSettings(map_crs="EPSG:4326"),
            f"CRS 'EPSG:4326' (WGS 84) is not a projected CRS, which a map conversion requires; {SET_CRS}",
        ),
        (
            Ifc(crs=CRS | {"Name": "EPSG:2056"}, conversion=CONVERSION),
            BY_IFC,
            "the centre of the model is at east, north, height [456641.2, 5421033.6, 179.8] m, outside the area of use "
            f"of EPSG:2056 (Liechtenstein; Switzerland); {CHECK}",
        ),
        (
            Ifc(crs=CRS, conversion=CONVERSION | {"Eastings": 5421033.5, "Northings": 456639.25}),
            BY_IFC,
            "the centre of the model is at east, north, height [5421035.5, 456639.4, 179.8] m, outside the area of use "
            f"of EPSG:25832 (Europe between 6°E and 12°E); with east and north exchanged it would lie in it; {CHECK}",
        ),
        (
            Ifc(crs=CRS, conversion=CONVERSION, boxes=[Box(corner_m=(456639.0, 5421033.0, 178.0))]),
            BY_IFC,
            "the model is shifted to the map twice: its geometry is at [456641.0, 5421033.2, 179.5] m, which are map "
            "coordinates of EPSG:25832, and its placement adds east, north [456639.2, 5421033.5] m; export it with "
            "only one of the two shifts, or, if the geometry is right, set crs.placement in the portfolio to "
            "{east_m: 0, north_m: 0, height_m: 0}",
        ),
    ],
    ids=[
        "no georeference", "no map conversion", "no vertical datum", "unknown vertical datum",
        "unknown vertical code in the IFC", "unknown vertical code in the portfolio", "horizontal as vertical",
        "grid not here", "unknown CRS in the IFC", "unknown CRS in the portfolio", "geographic CRS",
        "CRS of another country", "east and north swapped", "shift in geometry and conversion",
    ],
)  # fmt: skip
def test_a_model_that_cannot_be_placed(write_ifc: WriteIfc, ifc: Ifc, settings: IfcModelSettings, message: str) -> None:
    assert refused(GeoreferenceError, write_ifc(ifc), settings) == message


def test_the_remedies_for_crs_and_datum_help(write_ifc: WriteIfc) -> None:
    path = write_ifc(Ifc(crs={"Name": "Ettlingen local"}, conversion=CONVERSION))
    building = load_ifc_building(path, settings=IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal"))
    assert (building.map_crs, building.vertical_datum) == ("EPSG:25832", "ellipsoidal")


def test_the_remedy_for_a_model_without_map_conversion_helps(write_ifc: WriteIfc) -> None:
    """The keys that the message names are the portfolio's, and their values place the model."""
    building = Building.model_validate(
        {
            "id": "hall", "name": "Hall", "model": "hall.ifc", "photographs": "photos/{campaign}",
            "detector": {"kind": "coco", "file": "boxes.json"},
            "crs": {"placement": {"east_m": 456639.25, "north_m": 5421033.5, "height_m": 178.25, "rotation_deg": 30.0}},
        }
    )  # fmt: skip
    place = building.crs.placement
    assert place is not None
    placement = MapPlacement(
        east_m=place.east_m, north_m=place.north_m, height_m=place.height_m, rotation_deg=place.rotation_deg
    )
    model = load_ifc_building(write_ifc(Ifc(crs=CRS)), settings=IfcModelSettings(placement=placement))
    assert (model.georeference_level, model.map_crs) == ("registry", "EPSG:25832")
