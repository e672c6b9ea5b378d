"""One building of the portfolio, and the files of its campaigns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.registry.settings import (
    AcceptedStatement,
    BuildingCrs,
    CocoDetectorSetting,
    Identifier,
    IntakeSetting,
    KeptOutKind,
    OnnxDetectorSetting,
    PositionsSetting,
    Schedule,
    StoreySetting,
    StrictModel,
    Tolerances,
)
from facadelake.registry.surface_kinds import infer_surface_kind, require_applicable_keys
from schemas.vocabulary import SurfaceKind

CAMPAIGN = "{campaign}"


class Building(StrictModel):
    """One building of the portfolio; ``{campaign}`` in a path is replaced by the campaign id.

    ``model`` is an IFC, a mesh, or the keyword ``as-built`` for the as-built surface of the campaign where there is no
    model. ``model_building`` is the name of the IfcBuilding to use of an IFC with several. ``storeys`` are for models
    without storeys. ``positions`` None: those of XMP, else of EXIF. ``use_photographs`` are kinds of photographs that
    are kept out of the block by default. The default of ``detector`` is the default detector model.
    ``accept_placement`` are statements that may contradict the placement. ``priority``: whose campaigns are inspected
    first, where several wait. ``intake``: where its photographs arrive; None: they are put into ``photographs``.
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
    positions: PositionsSetting | None = None
    use_photographs: tuple[KeptOutKind, ...] = ()
    detector: Annotated[CocoDetectorSetting | OnnxDetectorSetting, Field(discriminator="kind")] = OnnxDetectorSetting(
        kind="onnx"
    )
    schedule: Schedule | None = None
    priority: Literal["low", "normal", "high"] = "normal"
    intake: IntakeSetting | None = None
    crs: BuildingCrs = BuildingCrs()
    storeys: tuple[StoreySetting, ...] = ()
    tolerances: Tolerances = Tolerances()
    accept_placement: tuple[AcceptedStatement, ...] = ()
    severity_rules: Identifier = "width_and_extent_v1"
    _variables: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _check_campaigns_distinct(self) -> Self:
        if CAMPAIGN not in self.photographs and not self.campaigns:
            raise ValueError(
                f"photographs '{self.photographs}' has no {CAMPAIGN} in it and 'campaigns' is empty, "
                f"so that campaigns cannot be distinguished; put {CAMPAIGN} in the path, or list the campaigns"
            )
        return self

    @model_validator(mode="after")
    def _check_intake_has_a_place(self) -> Self:
        if self.intake is not None and (CAMPAIGN not in self.photographs or self.campaigns):
            raise ValueError(
                f"'intake' puts each campaign that arrives in a folder of its own: put {CAMPAIGN} into 'photographs' "
                "and leave out 'campaigns'"
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
        """The kind of the building's surface: IFC, mesh or as-built."""
        return infer_surface_kind(self.model)

    def list_campaigns(self) -> tuple[str, ...]:
        """The campaigns of the portfolio, else those whose folder of photographs exists, in the order of their ids."""
        if self.campaigns:
            return tuple(sorted(self.campaigns))
        before, after = self.photographs.split(CAMPAIGN, 1)
        parent, prefix = self.locate_campaigns(), "" if before.endswith("/") else Path(before).name
        suffix = after.split("/", 1)[0]
        rest = after[len(suffix) :].lstrip("/")
        found = []
        for folder in parent.glob(f"{prefix}*{suffix}"):
            name = folder.name[len(prefix) : len(folder.name) - len(suffix)]
            if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name) and (folder / rest).is_dir():
                found.append(name)
        return tuple(sorted(found))

    def list_accepted_statements(self, campaign_id: str) -> tuple[AcceptedStatement, ...]:
        """The statements that may contradict the placement of the campaign."""
        return tuple(one for one in self.accept_placement if one.campaigns is None or campaign_id in one.campaigns)

    def locate_campaigns(self) -> Path:
        """The folder with an entry for each campaign, whether it exists or not."""
        before = self.photographs.split(CAMPAIGN, 1)[0]
        return Path(before) if before.endswith("/") else Path(before).parent

    def place_photographs(self, campaign_id: str) -> Path:
        """The folder that the campaign's photographs belong into, whether it exists or not."""
        return Path(self.photographs.replace(CAMPAIGN, campaign_id))

    def locate_photographs(self, campaign_id: str) -> Path:
        """The folder of the campaign's photographs. Raises InputDataError where it does not exist."""
        folder = self.place_photographs(campaign_id)
        if self.campaigns and campaign_id not in self.campaigns:
            raise InputDataError(
                f"building '{self.id}' has no campaign '{campaign_id}'{suggest_name(campaign_id, self.campaigns)}; "
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
        """The file of the building model. Raises InputDataError where it does not exist, and for ``as-built``."""
        return self._require_file(self.model, "model")

    def locate_offset_file(self) -> Path | None:
        """The offset file of a mesh; None where none is given. Raises InputDataError where it does not exist."""
        return self._require_file(self.crs.offset_file, "offset file") if self.crs.offset_file else None

    def locate_control_points(self, campaign_id: str) -> Path | None:
        """The file of control points; None where none is given or it does not exist."""
        return _find_file(self.control_points, campaign_id)

    def locate_check_points(self, campaign_id: str) -> Path | None:
        """The file of check points; None where none is given or it does not exist."""
        return _find_file(self.check_points, campaign_id)

    def locate_positions(self, campaign_id: str) -> Path | None:
        """The file of the photographs' positions; None: none is given. Raises InputDataError: it does not exist."""
        if self.positions is None or self.positions.file is None:
            return None
        return self._require_file(self.positions.file.replace(CAMPAIGN, campaign_id), "positions file")

    def locate_poses(self, campaign_id: str, choice: str | None) -> Path | None:
        """The file or folder of poses to import: ``choice``, else that of the portfolio; None: there is none.

        Raises InputDataError where it does not exist.
        """
        text = choice or self.poses
        if text is None:
            return None
        path = Path(text.replace(CAMPAIGN, campaign_id))
        if not path.exists():
            raise InputDataError(
                f"the poses {path} of building '{self.id}', campaign '{campaign_id}', do not exist; correct the path, "
                "or reconstruct the campaign: --georeference gcp, campaign, model or gps ignores poses of the portfolio"
            )
        return path

    def locate_detections(self, campaign_id: str, choice: str | None) -> Path:
        """The COCO file of detections: that of the portfolio, one of its alternatives by name, or a path.

        Raises InputDataError where it does not exist.
        """
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

    def _require_file(self, text: str, kind: str) -> Path:
        path = Path(text)
        if not path.is_file():
            raise InputDataError(f"the {kind} {path} of building '{self.id}' does not exist; {self._format_remedy()}")
        return path

    def _format_remedy(self) -> str:
        if self.id == "demo":
            return "run 'facadelake demo' first, which creates it"
        if self._variables:
            return f"correct the path in the portfolio, or set the environment variable {' or '.join(self._variables)}"
        return "correct the path in the portfolio"

    def record_variables(self, names: Sequence[str]) -> None:
        """Record the environment variables in the paths, which error messages name as a remedy."""
        self._variables = tuple(names)


def _find_file(template: str | None, campaign_id: str) -> Path | None:
    if template is None:
        return None
    path = Path(template.replace(CAMPAIGN, campaign_id))
    return path if path.is_file() else None
