"""What a person says of an upload: a small YAML file in its folder, the marker or ``campaign.yaml``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any, Literal

import yaml
from pydantic import ValidationError, field_validator

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.intake.listing import ListedFile
from facadelake.intake.source import UploadSource
from facadelake.registry import Building, Identifier, StrictModel

ANSWER_FILE = "campaign.yaml"
_LIMIT_BYTES = 65536
Accepted = Literal["dates", "position", "duplicate", "addition", "changed"]


class UploadAnswer(StrictModel):
    """A person's answer: the campaign that an upload is, and what is accepted although it contradicts.

    ``photographs``: how many there are; the upload is not complete before.
    """

    campaign: Identifier | None = None
    accept: tuple[Accepted, ...] = ()
    photographs: int | None = None

    @field_validator("campaign", mode="before")
    @classmethod
    def _read_date(cls, value: object) -> object:
        """YAML reads 2026-04-14 as a date, and 2026 as a number."""
        return value.isoformat() if isinstance(value, date) else str(value) if isinstance(value, int) else value

    @field_validator("accept", mode="before")
    @classmethod
    def _read_single(cls, value: object) -> object:
        return (value,) if isinstance(value, str) else value


@dataclass(frozen=True, kw_only=True)
class MarkerState:
    """The marker and answer of an upload as they are listed.

    ``name`` is that of the file for answers, ``is_required`` whether it is a marker. ``hint`` names a file that may be
    meant to be it.
    """

    name: str
    is_required: bool
    file: ListedFile | None
    hint: str = ""

    @property
    def missing(self) -> str:
        """The marker that is waited for; empty where none is."""
        return self.name if self.is_required and self.file is None else ""


def find_marker(building: Building, files: Sequence[ListedFile]) -> MarkerState:
    """The state of the marker of an upload's folder."""
    marker = building.intake.marker if building.intake else None
    name = marker or ANSWER_FILE
    found = next((file for file in files if file.path == name), None)
    hint = ""
    if marker is not None and found is None:
        top = [file.path for file in files if "/" not in file.path]
        similar = suggest_name(marker, top)
        hint = similar.replace("did you mean", "is it").replace("'?)", "'? then rename it)")
    return MarkerState(name=name, is_required=marker is not None, file=found, hint=hint)


def read_answer(source: UploadSource, folder: str, marker: MarkerState) -> UploadAnswer:
    """The answer in an upload; one without a word where there is none, or the file is no mapping.

    Raises InputDataError for keys and values that are not allowed, StoreError where the file cannot be read.
    """
    if marker.file is None or marker.file.bytes == 0:
        return UploadAnswer()
    content = source.read_start(folder, marker.file.path, _LIMIT_BYTES)
    try:
        answer: Any = yaml.safe_load(content.decode("utf-8-sig"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputDataError(
            f"its {marker.name} is not readable as YAML ({' '.join(str(error).split())}); write 'campaign: 2026-04', "
            "or leave it empty"
        ) from error
    if not isinstance(answer, dict):  # such as 'done'
        return UploadAnswer()
    try:
        return UploadAnswer.model_validate(answer)
    except ValidationError as error:
        mistakes = "; ".join(
            f"{'.'.join(map(str, one['loc']))}: {one['msg'].removeprefix('Value error, ')}" for one in error.errors()
        )
        raise InputDataError(
            f"its {marker.name} has mistakes ({mistakes}); allowed are 'campaign: 2026-04', 'accept: [dates, position, "
            "duplicate, addition, changed]' and 'photographs: 412'"
        ) from error
