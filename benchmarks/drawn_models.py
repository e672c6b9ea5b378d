"""Small IFC files whose georeference is stated in many ways, some of them wrong, and damage to their text."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace

import pyproj
from hypothesis import strategies as st

US_FOOT_M = 1200 / 3937
WALL_M = (20.0, 0.3, 3.0)

# Places in CRSs of several units, hemispheres and sizes: code, east, north (in its unit), height in metres.
PLACES = [
    ("EPSG:25832", 456639.25, 5421033.5, 178.25),
    ("EPSG:25833", 391234.5, 5819876.25, 34.5),
    ("EPSG:32756", 334873.1, 6252266.2, 12.0),
    ("EPSG:2154", 652381.2, 6862047.7, 35.0),
    ("EPSG:2169", 76670.0, 77179.0, 290.0),
    ("EPSG:6539", 987650.0, 213000.0, 9.0),
    ("EPSG:6538", 301000.0, 65000.0, 9.0),
    ("EPSG:3763", -87460.0, -106260.0, 20.0),
    ("EPSG:3857", 935950.0, 6264700.0, 178.0),
]
# Name and metres: the name is only compared with the factor.
UNITS = {
    "metre": ("METRE", 1.0), "millimetre": ("MILLIMETRE", 0.001), "foot": ("FOOT", 0.3048),
    "us foot": ("US SURVEY FOOT", US_FOOT_M), "revit us foot": ("FOOT_US", US_FOOT_M),
    "named foot": ("FOOT", US_FOOT_M), "inch": ("INCH", 0.0254), "wrong factor": ("FOOT", 304.8),
}  # fmt: skip
ELLIPSOIDAL_TEXTS = ("ellipsoidal", "Ellipsoidal height", "GRS80", "ellipsoidal (GRS80)")
OTHER_DATUMS = (
    "not ellipsoidal", "reference ellipsoid GRS80, heights DHHN92", "local zero", "EPSG:25832", "EPSG:99999",
    "sea level",
)  # fmt: skip
DESCRIPTIONS = (
    None, "ETRS89 / UTM", "reference ellipsoid GRS80, heights DHHN92", "heights are not ellipsoidal", "Ellipsoid GRS80",
)  # fmt: skip
STATED_DESCRIPTION = "map; heights are ellipsoidal"


@dataclass(frozen=True, kw_only=True)
class Statements:
    """What a file states; ``contradicts`` names what cannot be true of it, by construction."""

    crs: str
    east: float
    north: float
    height: float
    angle_deg: float = 0.0
    schema: str = "IFC4"
    project_unit: str | None = "metre"
    second_unit: str | None = None
    map_unit: str | None = "metre"
    scale: float | None = 1.0
    vertical: str | None = "ellipsoidal"
    description: str | None = None
    map_zone: str | None = None
    axis: tuple[float | None, float | None] | None = None
    world: tuple[float, float, float] = (0.0, 0.0, 0.0)
    norths: tuple[float, ...] = ()
    site: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    second_conversion: tuple[float, float, float] | None = None
    second_crs: str | None = None
    shared_guid: bool = False
    geometry_factor: float = 1.0
    changes: tuple[str, ...] = field(default=())
    contradicts: tuple[str, ...] = field(default=())


# ---------------------------------------------------------------- generated files


def is_projected_crs(name: str) -> bool:
    """Whether PROJ knows the name as a projected CRS."""
    try:
        return pyproj.CRS.from_user_input(name).is_projected
    except pyproj.exceptions.CRSError:
        return False


def compute_combined_factor(crs: str, east: float, north: float) -> float:
    """Map metres per metre on the ground, by PROJ's own factors, at height 0."""
    projection = pyproj.Proj(crs)
    lon, lat = projection(east, north, inverse=True)
    return float(math.sqrt(projection.get_factors(lon, lat).areal_scale))


@st.composite
def draw_statements(draw: st.DrawFn) -> Statements:
    """A correct file, and up to three changes of it."""
    crs, east, north, height_m = draw(st.sampled_from(PLACES))
    crs_m = pyproj.CRS(crs).axis_info[0].unit_conversion_factor
    map_unit = "us foot" if abs(crs_m - US_FOOT_M) < 1e-9 else "metre"
    project_unit = draw(st.sampled_from(["metre", "millimetre", "foot", "us foot"]))
    ratio = UNITS[project_unit][1] / UNITS[map_unit][1]
    grid = compute_combined_factor(crs, east, north)
    stated = Statements(
        crs=crs,
        east=east + draw(st.integers(-2000, 2000)) / 8,
        north=north + draw(st.integers(-2000, 2000)) / 8,
        height=(height_m + draw(st.integers(0, 400)) / 8) / crs_m,
        angle_deg=draw(st.sampled_from([0.0, 30.0, 90.0, -135.0, 7.25])),
        schema=draw(st.sampled_from(["IFC4", "IFC4X3"])),
        project_unit=project_unit,
        map_unit=map_unit,
        scale=ratio * draw(st.sampled_from([1.0, grid])) if crs != "EPSG:3857" else ratio * grid,
        vertical=draw(st.sampled_from(ELLIPSOIDAL_TEXTS)),
    )
    size = draw(st.sampled_from([0, 1, 1, 2, 2, 3]))
    for change in draw(st.lists(st.sampled_from(sorted(CHANGES)), min_size=size, max_size=size, unique=True)):
        stated = CHANGES[change](draw, stated)
        stated = replace(stated, changes=(*stated.changes, change))
    return stated


def _exchange(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, east=s.north, north=s.east)


def _negate(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, east=-s.east, north=draw(st.sampled_from([1, -1])) * s.north)


def _count_otherwise(draw: st.DrawFn, s: Statements) -> Statements:
    factor = draw(st.sampled_from([1000.0, 0.001, 1 / 0.3048, 0.3048, 1 / US_FOOT_M, 39.37]))
    return replace(s, east=s.east * factor, north=s.north * factor)


def _count_height_otherwise(draw: st.DrawFn, s: Statements) -> Statements:
    factor = draw(st.sampled_from([1000.0, 100.0, -1000.0, 1e6, 3.2808]))
    return replace(s, height=s.height * factor)


def _change_map_unit(draw: st.DrawFn, s: Statements) -> Statements:
    unit = draw(st.sampled_from([None, *UNITS]))
    return replace(s, map_unit=unit, contradicts=(*s.contradicts, *(["factor"] if unit == "wrong factor" else [])))


def _change_project_unit(draw: st.DrawFn, s: Statements) -> Statements:
    unit = draw(st.sampled_from([None, *UNITS]))
    return replace(s, project_unit=unit, contradicts=(*s.contradicts, *(["factor"] if unit == "wrong factor" else [])))


def _add_unit(draw: st.DrawFn, s: Statements) -> Statements:
    unit = draw(st.sampled_from(["metre", "millimetre", "foot"]))
    own_m = UNITS[s.project_unit or "metre"][1]
    differs = s.project_unit is not None and abs(UNITS[unit][1] / own_m - 1) > 1e-6
    return replace(s, second_unit=unit, contradicts=(*s.contradicts, *(["two units"] if differs else [])))


def _change_scale(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, scale=draw(st.sampled_from([None, 0.0, -1.0, 1.0, 0.001, 0.3048, 3.28084, 1000.0, 1.05, 0.9996])))


def _change_vertical(draw: st.DrawFn, s: Statements) -> Statements:
    text = draw(st.sampled_from([None, *OTHER_DATUMS]))
    description = draw(st.sampled_from([*DESCRIPTIONS, STATED_DESCRIPTION]))
    is_stated = text is None and description == STATED_DESCRIPTION
    conflicts = () if is_stated else ("no datum",)
    return replace(s, vertical=text, description=description, contradicts=(*s.contradicts, *conflicts))


def _change_crs(draw: st.DrawFn, s: Statements) -> Statements:
    name = draw(
        st.sampled_from(["EPSG:4258", "EPSG:4326", "EPSG:99999", "", "UTM 32", "EPSG:2056", "EPSG:25831", "EPSG:4978"])
    )
    known = name in ("EPSG:2056", "EPSG:25831")
    return replace(s, crs=name, contradicts=(*s.contradicts, *([] if known else ["no projected CRS"])))


def _add_zone(draw: st.DrawFn, s: Statements) -> Statements:
    zone = draw(st.sampled_from(["32", "UTM32", "33N", "56", "31"]))
    named = re.search(r"UTM zone (\d+)", pyproj.CRS(s.crs).name) if is_projected_crs(s.crs) else None
    differs = named is not None and named[1] != re.sub(r"\D", "", zone)
    return replace(s, map_zone=zone, contradicts=(*s.contradicts, *(["zone"] if differs else [])))


def _spoil_axis(draw: st.DrawFn, s: Statements) -> Statements:
    axis = draw(st.sampled_from([(0.0, 0.0), (1.0, None), (None, 1.0)]))
    return replace(s, axis=axis, contradicts=(*s.contradicts, "axis"))


def _shift_world(draw: st.DrawFn, s: Statements) -> Statements:
    world = draw(st.sampled_from([(100.0, 0.0, 0.0), (456639.0, 5421033.0, 178.0), (0.0, 0.0, 5.0)]))
    return replace(s, world=world, contradicts=(*s.contradicts, "world"))


def _add_norths(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, norths=tuple(draw(st.lists(st.sampled_from([0.0, 30.0, -12.5]), min_size=1, max_size=2))))


def _add_site(draw: st.DrawFn, s: Statements) -> Statements:
    latitude = draw(
        st.sampled_from([(48, 56, 25, 800000), (-33, -51, -31), (42, 21, 31, 181945), (99, 0, 0), (1, -5, 0)])
    )
    return replace(s, site=(latitude, draw(st.sampled_from([(8, 24, 28), (-71, -3, -24), (151, 12, 50)]))))


def _add_conversion(draw: st.DrawFn, s: Statements) -> Statements:
    shift = draw(st.sampled_from([0.0, 0.0, 1.0, 1000.0]))
    second = (s.east + shift, s.north, s.height)
    return replace(s, second_conversion=second, contradicts=(*s.contradicts, *(["two conversions"] if shift else [])))


def _add_crs(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, second_crs=draw(st.sampled_from(["EPSG:25832", "EPSG:25833"])))


def _share_guid(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, shared_guid=True)


def _count_geometry_otherwise(draw: st.DrawFn, s: Statements) -> Statements:
    return replace(s, geometry_factor=draw(st.sampled_from([1000.0, 0.001, 1e5])))


CHANGES = {
    "east and north exchanged": _exchange, "signs": _negate, "coordinates in another unit": _count_otherwise,
    "height in another unit": _count_height_otherwise, "MapUnit": _change_map_unit,
    "project unit": _change_project_unit, "second unit": _add_unit,
    "Scale": _change_scale, "vertical datum": _change_vertical, "CRS": _change_crs,
    "MapZone": _add_zone, "x axis": _spoil_axis, "WorldCoordinateSystem": _shift_world, "TrueNorth": _add_norths,
    "IfcSite": _add_site, "second conversion": _add_conversion, "second CRS": _add_crs, "shared GlobalId": _share_guid,
    "geometry in another unit": _count_geometry_otherwise,
}  # fmt: skip


def write_step(s: Statements) -> str:
    """The file in STEP text: two walls in a storey, and the statements."""
    lines: list[str] = []

    def add(text: str) -> str:
        lines.append(f"#{len(lines) + 1}={text};")
        return f"#{len(lines)}"

    def add_unit(name: str) -> str:
        label, metres = UNITS[name]
        if name in ("metre", "millimetre"):
            return add(f"IFCSIUNIT(*,.LENGTHUNIT.,{'.MILLI.' if name == 'millimetre' else '$'},.METRE.)")
        dimensions = add("IFCDIMENSIONALEXPONENTS(1,0,0,0,0,0,0)")
        measure = add(f"IFCMEASUREWITHUNIT(IFCLENGTHMEASURE({metres!r}),{add('IFCSIUNIT(*,.LENGTHUNIT.,$,.METRE.)')})")
        return add(f"IFCCONVERSIONBASEDUNIT({dimensions},.LENGTHUNIT.,'{label}',{measure})")

    def add_axes(x: float, y: float, z: float) -> str:
        return add(f"IFCAXIS2PLACEMENT3D({add(f'IFCCARTESIANPOINT(({x!r},{y!r},{z!r}))')},$,$)")

    units = [add_unit(name) for name in (s.project_unit, s.second_unit) if name]
    units.append(add("IFCSIUNIT(*,.PLANEANGLEUNIT.,$,.RADIAN.)"))
    assignment = add(f"IFCUNITASSIGNMENT(({','.join(units)}))")
    unit_m = UNITS[s.project_unit or "metre"][1]
    norths: list[float | None] = [*s.norths] or [None]
    contexts = []
    for angle in norths:
        north = "$"
        if angle is not None:
            north = add(f"IFCDIRECTION(({math.sin(math.radians(angle))!r},{math.cos(math.radians(angle))!r}))")
        axes = add_axes(*(value / unit_m for value in s.world))
        contexts.append(add(f"IFCGEOMETRICREPRESENTATIONCONTEXT($,'Model',3,1.E-05,{axes},{north})"))
    body = add(f"IFCGEOMETRICREPRESENTATIONSUBCONTEXT('Body','Model',*,*,*,*,{contexts[0]},$,.MODEL_VIEW.,$)")
    project = add(f"IFCPROJECT('0000000000000000000001',$,'P',$,$,$,$,({','.join(contexts)}),{assignment})")
    place = add(f"IFCLOCALPLACEMENT($,{add_axes(0.0, 0.0, 0.0)})")
    angles = ["$", "$"] if s.site is None else [f"({','.join(str(part) for part in angle)})" for angle in s.site]
    site = add(f"IFCSITE('0000000000000000000002',$,'S',$,$,{place},$,$,.ELEMENT.,{angles[0]},{angles[1]},$,$,$)")
    building = add(f"IFCBUILDING('0000000000000000000003',$,'B',$,$,{place},$,$,.ELEMENT.,$,$,$)")
    storey = add(f"IFCBUILDINGSTOREY('0000000000000000000004',$,'EG',$,$,{place},$,$,.ELEMENT.,0.)")
    for number, (whole, part) in enumerate([(project, site), (site, building), (building, storey)]):
        add(f"IFCRELAGGREGATES('000000000000000000001{number}',$,$,$,{whole},({part}))")
    walls = []
    for number, corner_y in enumerate((0.0, 8.0)):
        x, y, z = (value * s.geometry_factor / unit_m for value in WALL_M)
        corner = add(f"IFCCARTESIANPOINT(({x / 2!r},{y / 2!r}))")
        profile = add(f"IFCRECTANGLEPROFILEDEF(.AREA.,$,{add(f'IFCAXIS2PLACEMENT2D({corner},$)')},{x!r},{y!r})")
        up = add("IFCDIRECTION((0.,0.,1.))")
        solid = add(f"IFCEXTRUDEDAREASOLID({profile},{add_axes(0.0, 0.0, 0.0)},{up},{z!r})")
        shape = add(
            f"IFCPRODUCTDEFINITIONSHAPE($,$,({add(f'IFCSHAPEREPRESENTATION({body},{chr(39)}Body{chr(39)},{chr(39)}SweptSolid{chr(39)},({solid}))')}))"
        )
        own = add(f"IFCLOCALPLACEMENT({place},{add_axes(0.0, corner_y * s.geometry_factor / unit_m, 0.0)})")
        guid = "0000000000000000000020" if s.shared_guid else f"000000000000000000002{number}"
        predefined = ",$" if s.schema != "IFC2X3" else ""
        walls.append(add(f"IFCWALL('{guid}',$,'wall {number}',$,$,{own},{shape},$" + predefined + ")"))
    add(f"IFCRELCONTAINEDINSPATIALSTRUCTURE('0000000000000000000030',$,$,$,({','.join(walls)}),{storey})")
    text = [None if value is None else f"'{value}'" for value in (s.description, s.vertical, s.map_zone)]
    description, vertical, zone = (value or "$" for value in text)
    map_unit = add_unit(s.map_unit) if s.map_unit else "$"
    crs = add(f"IFCPROJECTEDCRS('{s.crs}',{description},$,{vertical},$,{zone},{map_unit})")
    direction = s.axis or (math.cos(math.radians(s.angle_deg)), math.sin(math.radians(s.angle_deg)))
    axis = [_format(value) for value in (*direction, s.scale)]
    values = f"{s.east!r},{s.north!r},{s.height!r},{','.join(axis)}"
    add(f"IFCMAPCONVERSION({contexts[0]},{crs},{values})")
    if s.second_conversion:
        add(
            f"IFCMAPCONVERSION({contexts[-1]},{crs},{','.join(repr(value) for value in s.second_conversion)},"
            f"{','.join(axis)})"
        )
    if s.second_crs:
        add(f"IFCPROJECTEDCRS('{s.second_crs}',$,$,'ellipsoidal',$,$,$)")
    header = (
        f"HEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\nFILE_SCHEMA(('{s.schema}'));"
    )
    data = "\n".join(lines)
    return f"ISO-10303-21;\n{header}\nENDSEC;\nDATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n"


def _format(value: float | None) -> str:
    return "$" if value is None else repr(float(value))


@st.composite
def draw_damage(draw: st.DrawFn, text: str) -> str:
    """The text with up to three attributes, characters or lines changed."""
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["attribute", "attribute", "character", "line", "reference"]))
        spans = [match.span() for match in re.finditer(r"(?<=[(,])[^(),]+(?=[),])", text)]
        if kind == "character":
            at = draw(st.integers(300, len(text) - 30))
            text = text[:at] + draw(st.sampled_from(list("0123456789.,()'#$*;E-\n\0é"))) + text[at + 1 :]
        elif kind == "line":
            lines = text.split("\n")
            del lines[draw(st.integers(8, len(lines) - 4))]
            text = "\n".join(lines)
        else:
            start, end = draw(st.sampled_from(spans))
            other = ["$", "*", "''", "'x'", "0.", "-1.", "1.E308", "1", ".T.", "#1", "#9999", "()", "'é'", "NAN"]
            if kind == "reference":
                other = [f"#{number}" for number in range(1, 60)]
            text = text[:start] + draw(st.sampled_from(other)) + text[end:]
    return text
