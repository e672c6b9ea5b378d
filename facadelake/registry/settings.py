"""Settings of a building in the portfolio: schedule, georeference, tolerances, detector."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Literal, Self
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from cronsim import CronSim, CronSimError
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from facadelake.registry.crs_values import (
    check_gnss_crs,
    check_map_crs,
    check_one_vertical_datum,
    check_vertical_datum,
)
from schemas.vocabulary import DefectClass


class StrictModel(BaseModel):
    """A mapping of the portfolio: immutable, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_CRON_REMEDY = "use five fields: minute hour day month weekday, such as '0 6 1 4,10 *'"
_NO_DATE = "no date: there is no day {day} in month {month}; give days that the months have, or L for their last one"


def _check_time_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError) as error:
        raise ValueError("not a time zone; use a name of the IANA list such as Europe/Berlin or UTC") from error
    return name


def _check_cron(expression: str) -> str:
    fields = expression.split()
    # A sixth field is the seconds, before the others for some programs and after them for Prefect.
    if len(fields) != 5:
        raise ValueError(f"not a cron expression ({len(fields)} fields); {_CRON_REMEDY}")
    try:
        next(CronSim(expression, datetime(2026, 1, 1, tzinfo=UTC)))
    except CronSimError as error:
        if "day-of-month" in str(error) and re.fullmatch(r"[\d,-]+", fields[2]):
            raise ValueError(_NO_DATE.format(day=fields[2], month=fields[3])) from error
        raise ValueError(f"not a cron expression ({error}); {_CRON_REMEDY}") from error
    except StopIteration as error:
        raise ValueError(_NO_DATE.format(day=fields[2], month=fields[3])) from error
    day, weekday = fields[2], fields[4]
    if "*" not in (day, weekday) and (day.startswith("*") or weekday.startswith("*")):
        raise ValueError(
            f"day '{day}' and weekday '{weekday}': cron takes the days that are both, Prefect those that are either; "
            "give '*' for one of the two"
        )
    if re.search(r"W|\dL", f"{day} {weekday}".upper().replace("WED", "")):
        raise ValueError(f"day '{day}', weekday '{weekday}': Prefect knows no W and no weekday with L; {_CRON_REMEDY}")
    return expression


def _check_identifier(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", text):
        raise ValueError("an id consists of letters, digits, '.', '_' and '-', and begins with a letter or digit")
    return text


# Kinds of photographs that are kept out of the block unless the portfolio uses them.
KeptOutKind = Literal["thermal", "panorama", "spectral_band", "other_lens"]
Identifier = Annotated[str, AfterValidator(_check_identifier)]


class Schedule(StrictModel):
    """Schedule of inspections: a cron expression in a time zone, and the cycle that the law asks for.

    ``early_days``: photographs taken up to so many days before a date of ``cron`` count for that date, at most half the
    time since the date before it; later ones count for the date that has passed.
    ``cycle_months``: largest number of months between two inspections by law; None: none is known.
    """

    cron: Annotated[str, AfterValidator(_check_cron)]
    timezone: Annotated[str, AfterValidator(_check_time_zone)] = "UTC"
    early_days: Annotated[int, Field(ge=0, le=366)] = 30
    cycle_months: Annotated[int, Field(ge=1, le=240)] | None = None


class IntakeSetting(StrictModel):
    """Where a building's photographs arrive: ``source`` is a folder or an ``s3://`` prefix, with a folder a campaign.

    A campaign is complete when its folder holds a file of the name ``marker``; without ``marker``, when nothing in it
    has changed for ``quiet_minutes`` (None: the service's).
    """

    source: Annotated[str, Field(min_length=1)]
    marker: Annotated[str, Field(min_length=1)] | None = None
    quiet_minutes: Annotated[float, Field(gt=0, le=14400)] | None = None


class SiteOriginSetting(StrictModel):
    """Origin of the site frame in EPSG:4979, instead of that of the model."""

    lon_deg: Annotated[float, Field(ge=-180, le=180)]
    lat_deg: Annotated[float, Field(ge=-90, le=90)]
    height_ellipsoidal_m: Annotated[float, Field(ge=-1000, le=10000)]


class PlacementSetting(StrictModel):
    """Origin of the model in the projected CRS: metres, and degrees anticlockwise from map east to the model's x axis.

    ``scale`` is that of east and north, such as 0.9996 of the grid; one that changes the building's size is refused.
    """

    east_m: float
    north_m: float
    height_m: float
    rotation_deg: float = 0.0
    scale: Annotated[float, Field(ge=0.9, le=1.1)] = 1.0


class ControlPairSetting(StrictModel):
    """A point in the axes of the model and on the map (east, north, height in the vertical datum), metres."""

    ifc_m: tuple[float, float, float]
    map_m: tuple[float, float, float]


LengthUnitName = Literal["metre", "centimetre", "millimetre", "inch", "foot", "us_survey_foot"]


class BuildingCrs(StrictModel):
    """Georeference of a model without one, or instead of its own; see docs/georeference-levels.md.

    ``map`` is a projected CRS such as EPSG:25832; ``vertical`` is ``ellipsoidal`` or a vertical CRS such as EPSG:7837.
    ``accept_level`` accepts a georeference with an accuracy of metres, down to that LoGeoRef level.
    ``accept_operation_accuracy_m`` accepts the best coordinate operation that is installed, where a better one lacks
    its grid, up to that accuracy. ``gnss`` is the geographic CRS of the photographs' positions, such as EPSG:4258 for
    corrections of a service in ETRS89. For meshes
    (docs/without-bim.md): ``offset_file`` contains the position of their origin, ``axes`` is the upward axis, ``unit``
    the unit of length. ``map_unit`` is the unit of an IFC's map coordinates where its MapUnit is missing or wrong.
    """

    map: Annotated[str, AfterValidator(check_map_crs)] | None = None
    vertical: Annotated[str, AfterValidator(check_vertical_datum)] | None = None
    placement: PlacementSetting | None = None
    control: tuple[ControlPairSetting, ...] = ()
    accept_level: Literal[20, 40] | None = None
    map_unit: LengthUnitName | None = None
    accept_operation_accuracy_m: Annotated[float, Field(gt=0, le=100)] | None = None
    gnss: Annotated[str, AfterValidator(check_gnss_crs)] | None = None
    offset_file: str | None = None
    axes: Literal["z-up", "y-up"] | None = None
    unit: LengthUnitName | None = None
    origin: SiteOriginSetting | None = None

    @model_validator(mode="after")
    def _check_single_placement(self) -> Self:
        if self.placement and self.control:
            raise ValueError("both 'placement' and 'control' place the model; give one of them")
        return self

    @model_validator(mode="after")
    def _check_single_vertical_datum(self) -> Self:
        if self.map and self.vertical:
            check_one_vertical_datum(self.map, self.vertical)
        return self


class StoreySetting(StrictModel):
    """A storey of a model without storeys: the height of its floor in the vertical datum, metres."""

    name: Annotated[str, Field(min_length=1)]
    floor_m: float


class Tolerances(StrictModel):
    """Limits of the stages; the suffix of each name is its unit.

    ``features_max_image_px``: longer side to which photographs are reduced before feature extraction.
    ``model_sigma_m``: standard deviation of the building as built from its model (DIN 18202 allows 24 mm for walls of
    15 m). ``placement_sigma_max_m``: a campaign whose position has a larger standard deviation is refused.
    """

    close_range_below_m: Annotated[float, Field(gt=0)] = 8.0
    grazing_above_deg: Annotated[float, Field(gt=0, le=90)] = 80.0
    target_share_min: Annotated[float, Field(ge=0, le=1)] = 0.5
    features_max_image_px: Annotated[int, Field(ge=500, le=20000)] = 3200
    model_sigma_m: Annotated[float, Field(gt=0, le=1)] = 0.03
    placement_sigma_max_m: Annotated[float, Field(gt=0)] = 0.5


class AcceptedStatement(StrictModel):
    """A statement that may contradict the placement of campaigns, up to a limit and for a ``reason`` on record.

    ``statement`` is one of table ``placement_checks``. ``deviation_max_m`` is the largest deviation that is accepted,
    ``share_min`` the smallest share, of statements in metres and in shares. ``campaigns`` None: all of the building.
    """

    statement: Literal["gps_position", "gps_height", "surveyed_points", "camera_height", "model_in_view", "tie_points"]
    deviation_max_m: Annotated[float, Field(gt=0, le=1000)] | None = None
    share_min: Annotated[float, Field(ge=0, lt=1)] | None = None
    reason: Annotated[str, Field(min_length=10)]
    campaigns: tuple[Identifier, ...] | None = None

    @model_validator(mode="after")
    def _check_single_limit(self) -> Self:
        if (self.deviation_max_m is None) == (self.share_min is None):
            raise ValueError("give one limit: 'deviation_max_m' in metres, or 'share_min' of photographs or tie points")
        in_metres = self.statement not in ("model_in_view", "tie_points")
        if (in_metres and self.share_min is not None) or (self.statement == "model_in_view" and self.deviation_max_m):
            limit = "deviation_max_m" if in_metres else "share_min"
            raise ValueError(f"'{self.statement}' is compared by '{limit}'; give that one")
        return self


class PositionsSetting(StrictModel):
    """Which statement of the photographs' positions counts: that of XMP, of EXIF, or of a file.

    In the portfolio ``positions: exif`` is short for ``positions: {source: exif}``, and ``source`` is ``file`` where a
    ``file`` is given. ``columns`` are the names of its columns, where it has no header. ``vertical`` is the datum of
    its heights: ``ellipsoidal`` or a vertical CRS such as EPSG:7837; without it that which the file states, else
    unknown.
    ``sigma_horizontal_m`` and ``sigma_vertical_m`` are those of positions for which the file states none.
    """

    source: Literal["xmp", "exif", "file"]
    file: str | None = None
    columns: tuple[str, ...] = ()
    vertical: (
        Annotated[str, Field(pattern=r"^(ellipsoidal|EPSG:\d+)$"), AfterValidator(check_vertical_datum)] | None
    ) = None
    sigma_horizontal_m: Annotated[float, Field(gt=0)] | None = None
    sigma_vertical_m: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _expand_short_form(cls, value: object) -> object:
        if isinstance(value, str):
            return {"source": value}
        if isinstance(value, dict) and "file" in value:
            return {"source": "file"} | value
        return value

    @model_validator(mode="after")
    def _check_file(self) -> Self:
        of_file = (self.columns, self.vertical, self.sigma_horizontal_m, self.sigma_vertical_m)
        if (self.source == "file") != (self.file is not None) or (self.file is None and any(of_file)):
            raise ValueError("give 'xmp', 'exif', or a mapping with 'file', to which the other keys belong")
        if (self.sigma_horizontal_m is None) != (self.sigma_vertical_m is None):
            raise ValueError("give both 'sigma_horizontal_m' and 'sigma_vertical_m', or neither")
        return self


Recall = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(ge=0, le=1)]]


class RecallBySize(StrictModel):
    """Share of the defects of a size that a detector finds: pairs of a size in pixels and the recall at that size.

    ``crack_width_px``: by the mean width of a crack. ``patch_px``: by the root of the area of spalling or moisture.
    Sizes are of the picture that the detector is given, in ascending order. A single pair such as ``[3, 0.9]`` states
    one size. A kind without pairs is unknown.
    """

    crack_width_px: tuple[Recall, ...] = ()
    patch_px: tuple[Recall, ...] = ()

    @model_validator(mode="after")
    def _check_ascending(self) -> Self:
        for kind in ("crack_width_px", "patch_px"):
            sizes = [size for size, _ in getattr(self, kind)]
            if any(after <= before for before, after in pairwise(sizes)):
                raise ValueError(f"the sizes of {kind} are {sizes}; list them in ascending order, each once")
        return self


class ExifView(StrEnum):
    """View of a photograph that EXIF turns: its pixels as stored, or turned as viewers display them."""

    STORED = "stored"
    DISPLAYED = "displayed"


class CocoDetectorSetting(StrictModel):
    """Detections are imported from a COCO file of an external detector or of a person.

    ``alternatives`` are further files by name, from which a run can select one. ``exif_view``: whether boxes of
    photographs that EXIF turns are of the pixels as ``stored`` or of the photograph as ``displayed``; None: as the
    sizes in the file tell, and boxes are not used where these do not tell. ``recall_by_size``: how small a defect the
    external detector or the person finds; None: unknown, so that coverage states no smallest defect.
    """

    kind: Literal["coco"]
    file: str
    alternatives: dict[str, str] = {}
    classes: dict[str, DefectClass] = {}
    exif_view: ExifView | None = None
    recall_by_size: RecallBySize | None = None


DEFAULT_MODEL = "default"  # keyword in place of the path of a detector model


class OnnxDetectorSetting(StrictModel):
    """Detections are inferred by an ONNX model: a file, or the keyword ``default`` for the promoted default model.

    ``card`` is the model card; None: ``crack.card.yaml`` beside ``crack.onnx``. ``score_threshold`` replaces that of
    the card. ``threads`` is the number of threads; None: one per processor core.
    """

    kind: Literal["onnx"]
    model: str = DEFAULT_MODEL
    card: str | None = None
    classes: dict[str, DefectClass] = {}
    score_threshold: Annotated[float, Field(ge=0, le=1)] | None = None
    threads: Annotated[int, Field(ge=1)] | None = None
