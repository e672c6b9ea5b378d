"""One building of the registry, as a person writes it and as the flow uses it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, Self
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from cronsim import CronSim, CronSimError
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from facadelake.core.errors import InputDataError
from facadelake.registry.surface_kinds import infer_surface_kind, require_applicable_keys
from schemas.vocabulary import DefectClass, SurfaceKind

CAMPAIGN = "{campaign}"


class StrictModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _check_time_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError) as error:
        raise ValueError("not a time zone; use a name of the IANA list such as Europe/Berlin or UTC") from error
    return name


def _check_cron(expression: str) -> str:
    try:
        CronSim(expression, datetime(2026, 1, 1, tzinfo=UTC))
    except CronSimError as error:
        raise ValueError(
            f"not a cron expression ({error}); use five fields: minute hour day month weekday, such as '0 6 1 4,10 *'"
        ) from error
    return expression


def _check_identifier(word: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", word):
        raise ValueError("an id is letters, digits, '.', '_' and '-', and begins with a letter or digit")
    return word


Identifier = Annotated[str, AfterValidator(_check_identifier)]


class Schedule(StrictModel):
    """When the building is inspected: a cron expression in a time zone."""

    cron: Annotated[str, AfterValidator(_check_cron)]
    timezone: Annotated[str, AfterValidator(_check_time_zone)] = "UTC"


class SiteOriginSetting(StrictModel):
    """Origin of the site frame in EPSG:4979, where it is not to be taken from the model."""

    lon_deg: Annotated[float, Field(ge=-180, le=180)]
    lat_deg: Annotated[float, Field(ge=-90, le=90)]
    height_ellipsoidal_m: Annotated[float, Field(ge=-1000, le=10000)]


class PlacementSetting(StrictModel):
    """Where the model's zero lies in the projected CRS: metres, and degrees anticlockwise from map east to model x.

    ``scale`` is of east and north, such as the grid's 0.9996.
    """

    east_m: float
    north_m: float
    height_m: float
    rotation_deg: float = 0.0
    scale: Annotated[float, Field(gt=0)] = 1.0


class ControlPairSetting(StrictModel):
    """A point in the model's axes and the same on the map (east, north, height in the vertical datum), metres."""

    ifc_m: tuple[float, float, float]
    map_m: tuple[float, float, float]


class BuildingCrs(StrictModel):
    """Overrides for a model that does not say where it stands; see docs/georeference-levels.md.

    ``map`` is a projected CRS such as EPSG:25832; ``vertical`` is ``ellipsoidal`` or a vertical CRS such as EPSG:7837.
    ``accept_level`` takes a georeference that is good to metres alone, down to that LoGeoRef. For meshes
    (docs/without-bim.md): ``offset_file`` says where their zero lies, ``axes`` what is up, ``unit`` what they count in.
    """

    map: str | None = None
    vertical: str | None = None
    placement: PlacementSetting | None = None
    control: tuple[ControlPairSetting, ...] = ()
    accept_level: Literal[20, 40] | None = None
    offset_file: str | None = None
    axes: Literal["z-up", "y-up"] | None = None
    unit: Literal["metre", "millimetre", "foot", "us_survey_foot"] | None = None
    origin: SiteOriginSetting | None = None

    @model_validator(mode="after")
    def _check_single_placement(self) -> Self:
        if self.placement and self.control:
            raise ValueError("both 'placement' and 'control' place the model; give one of them")
        return self


class StoreySetting(StrictModel):
    """A storey where the model names none: the height of its floor in the vertical datum, metres."""

    name: Annotated[str, Field(min_length=1)]
    floor_m: float


class Tolerances(StrictModel):
    """Limits of the stages; each says its unit.

    ``features_max_image_px``: photographs are reduced to this longer side before features are looked for.
    ``model_sigma_m``: how far the building as built may stand off its model, one sigma (DIN 18202 allows walls of 15 m
    24 mm). ``placement_sigma_max_m``: a campaign that is placed worse than this (one sigma) is refused.
    """

    close_range_below_m: Annotated[float, Field(gt=0)] = 8.0
    grazing_above_deg: Annotated[float, Field(gt=0, le=90)] = 80.0
    target_share_min: Annotated[float, Field(ge=0, le=1)] = 0.5
    features_max_image_px: Annotated[int, Field(ge=500, le=20000)] = 3200
    model_sigma_m: Annotated[float, Field(gt=0, le=1)] = 0.03
    placement_sigma_max_m: Annotated[float, Field(gt=0)] = 0.5


class CocoDetectorSetting(StrictModel):
    """Detections are read from a COCO file: an outside detector's, or a person's boxes.

    ``alternatives`` names further files, so that a run can choose one by name.
    """

    kind: Literal["coco"]
    file: str
    alternatives: dict[str, str] = {}
    classes: dict[str, DefectClass] = {}


DEFAULT_MODEL = "default"  # stands where a detector model's path would


class OnnxDetectorSetting(StrictModel):
    """Detections are made by an ONNX model: a file, or the word ``default`` for the one that Facadelake ships.

    Its card, ``crack.card.yaml`` beside ``crack.onnx`` unless ``card`` says another, declares its layout.
    ``score_threshold`` stands in for the card's; ``threads`` for one a core.
    """

    kind: Literal["onnx"]
    model: str = DEFAULT_MODEL
    card: str | None = None
    classes: dict[str, DefectClass] = {}
    score_threshold: Annotated[float, Field(ge=0, le=1)] | None = None
    threads: Annotated[int, Field(ge=1)] | None = None


class Building(StrictModel):
    """One building of the registry; ``{campaign}`` in a path stands for the campaign's id.

    ``model`` is an IFC, a mesh, or the word ``as-built``: the campaign's own surface, where there is no model.
    ``model_building`` names the one IfcBuilding to take of an IFC with several. ``storeys`` stand in where the model
    has none. Without ``detector`` the default model looks for defects.
    """

    id: Identifier
    name: Annotated[str, Field(min_length=1)]
    model: str
    model_building: str | None = None
    photographs: str
    campaigns: tuple[Identifier, ...] = ()
    control_points: str | None = None
    check_points: str | None = None
    poses: str | None = None
    detector: Annotated[CocoDetectorSetting | OnnxDetectorSetting, Field(discriminator="kind")] = OnnxDetectorSetting(
        kind="onnx"
    )
    schedule: Schedule | None = None
    crs: BuildingCrs = BuildingCrs()
    storeys: tuple[StoreySetting, ...] = ()
    tolerances: Tolerances = Tolerances()
    severity_rules: Identifier = "extent_v1"
    _variables: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _check_campaigns_distinct(self) -> Self:
        if CAMPAIGN not in self.photographs and not self.campaigns:
            raise ValueError(
                f"photographs '{self.photographs}' has no {CAMPAIGN} in it and 'campaigns' is empty, "
                f"so no campaign can be told from another; put {CAMPAIGN} in the path, or list the campaigns"
            )
        return self

    @model_validator(mode="after")
    def _check_applicable_keys(self) -> Self:
        own = {"storeys": self.storeys, "model_building": self.model_building}
        given = {key for key, value in (*self.crs, *own.items()) if value}
        require_applicable_keys(self.model, given)
        return self

    @property
    def surface_kind(self) -> SurfaceKind:
        """What the building's surface is made of."""
        return infer_surface_kind(self.model)

    def list_campaigns(self) -> tuple[str, ...]:
        """The campaigns listed, or those whose photographs' folder exists, oldest id first."""
        if self.campaigns:
            return tuple(sorted(self.campaigns))
        before, after = self.photographs.split(CAMPAIGN, 1)
        parent, prefix = (Path(before), "") if before.endswith("/") else (Path(before).parent, Path(before).name)
        suffix = after.split("/", 1)[0]
        rest = after[len(suffix) :].lstrip("/")
        found = []
        for folder in parent.glob(f"{prefix}*{suffix}"):
            name = folder.name[len(prefix) : len(folder.name) - len(suffix)]
            if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name) and (folder / rest).is_dir():
                found.append(name)
        return tuple(sorted(found))

    def locate_photographs(self, campaign_id: str) -> Path:
        """Folder of the campaign's photographs. Raises InputDataError where it is missing."""
        folder = Path(self.photographs.replace(CAMPAIGN, campaign_id))
        if self.campaigns and campaign_id not in self.campaigns:
            raise InputDataError(
                f"building '{self.id}' has no campaign '{campaign_id}'; "
                f"it has {', '.join(self.campaigns)} (key 'campaigns')"
            )
        if not folder.is_dir():
            known = ", ".join(self.list_campaigns()) or "none found"
            raise InputDataError(
                f"the photographs' folder {folder} of building '{self.id}', campaign '{campaign_id}', does not exist "
                f"(campaigns with photographs: {known}); {self._format_remedy()}"
            )
        return folder

    def locate_model(self) -> Path:
        """The building model's file. Raises InputDataError where it is missing; ``as-built`` has none."""
        return self._require_file(self.model, "model")

    def locate_offset_file(self) -> Path | None:
        """The file that says where a mesh's zero lies, if the registry names one. Raises where it is missing."""
        return self._require_file(self.crs.offset_file, "offset file") if self.crs.offset_file else None

    def locate_control_points(self, campaign_id: str) -> Path | None:
        """The control points' file, where the registry names one and it exists."""
        return _find_file(self.control_points, campaign_id)

    def locate_check_points(self, campaign_id: str) -> Path | None:
        """The file of points that are held out of the adjustment to judge it, where there is one."""
        return _find_file(self.check_points, campaign_id)

    def locate_poses(self, campaign_id: str, choice: str | None) -> Path | None:
        """Poses to import: ``choice`` (a file or folder), else the registry's; None: they are to be found anew.

        Raises InputDataError where they are named and not there.
        """
        text = choice or self.poses
        if text is None:
            return None
        path = Path(text.replace(CAMPAIGN, campaign_id))
        if not path.exists():
            raise InputDataError(
                f"the poses {path} of building '{self.id}', campaign '{campaign_id}', do not exist; correct the path, "
                "or find the poses anew: --georeference gcp, campaign, model or gps leaves the registry's poses out"
            )
        return path

    def locate_detections(self, campaign_id: str, choice: str | None) -> Path:
        """The COCO file to read: the registry's, one of its alternatives by name, or a path."""
        assert isinstance(self.detector, CocoDetectorSetting)
        if choice is None:
            template = self.detector.file
        elif choice in self.detector.alternatives:
            template = self.detector.alternatives[choice]
        elif Path(choice).is_file():
            template = choice
        else:
            names = ", ".join(self.detector.alternatives) or "none"
            raise InputDataError(
                f"detections '{choice}' are neither a file nor one of building '{self.id}'s alternatives ({names}); "
                "give a path, or add the name under detector: alternatives"
            )
        return self._require_file(template.replace(CAMPAIGN, campaign_id), "detections file")

    def _require_file(self, text: str, what: str) -> Path:
        path = Path(text)
        if not path.is_file():
            raise InputDataError(f"the {what} {path} of building '{self.id}' does not exist; {self._format_remedy()}")
        return path

    def _format_remedy(self) -> str:
        if self.id == "demo":
            return "run 'facadelake demo' first, which makes it"
        if self._variables:
            return f"correct the path in the registry, or set the environment variable {' or '.join(self._variables)}"
        return "correct the path in the registry"

    def record_variables(self, names: Sequence[str]) -> None:
        """Keep which environment variables the paths were made of, for messages that name the remedy."""
        self._variables = tuple(names)


def _find_file(template: str | None, campaign_id: str) -> Path | None:
    if template is None:
        return None
    path = Path(template.replace(CAMPAIGN, campaign_id))
    return path if path.is_file() else None
