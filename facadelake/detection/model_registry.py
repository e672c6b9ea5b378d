"""The model registry: which detector ``default`` means, who promoted it and why.

A folder of models with ``models.yaml``, the list of promotions; its last entry is the default, earlier models are kept.
Without the list, the default is the model that Facadelake ships.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import yaml
from filelock import FileLock, Timeout
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import ModelError, StoreError
from facadelake.core.hashing import hash_file
from facadelake.detection.card import format_card, locate_card
from facadelake.detection.inference.card_lookup import find_card

MODELS_FOLDER = Path(os.environ.get("FACADELAKE_MODELS") or CHECKOUT / "data" / "detector")
MODEL_LIST = "models.yaml"
SHIPPED_MODEL = "facadelake-nano.onnx"
_LOCK_TIMEOUT_S = 30.0
_HEADER = "# Which detector 'model: default' means: the last entry. Written by 'facadelake promote-model'.\n"


class Promotion(BaseModel):
    """A model that became the default.

    ``file`` lies in the model registry's folder; ``replaces`` is the SHA-256 of the previous default; ``evidence`` is
    the reason for the promotion, as text.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    file: Annotated[str, Field(pattern=r"^[^/\\]+\.onnx$")]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    promoted_at: datetime
    by: Annotated[str, Field(min_length=1)]
    why: Annotated[str, Field(min_length=1)]
    replaces: str | None = None
    evidence: str = ""


def read_promotions(folder: Path = MODELS_FOLDER) -> tuple[Promotion, ...]:
    """All promotions, oldest first. Raises ModelError if the list cannot be read."""
    path = folder / MODEL_LIST
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8")) if path.is_file() else []
        return tuple(Promotion.model_validate(entry) for entry in content or [])
    except (OSError, UnicodeDecodeError, yaml.YAMLError, TypeError, ValidationError) as error:
        raise ModelError(
            f"{path}, the list of promoted detectors, cannot be read: {error}; correct it, or remove the faulty entry"
        ) from error


def find_default_model(folder: Path = MODELS_FOLDER) -> Path:
    """The ONNX file that ``model: default`` means: the last one promoted, else the shipped one.

    Raises ModelError if it is missing or differs from the file that was promoted.
    """
    known = read_promotions(folder)
    path = folder / (known[-1].file if known else SHIPPED_MODEL)
    if not path.is_file():
        raise ModelError(
            f"the default detector {path} does not exist; restore it, promote another with 'facadelake promote-model', "
            "or name a model's file in the portfolio"
        )
    if known and hash_file(path) != known[-1].sha256:
        raise ModelError(
            f"the default detector {path} was changed after {known[-1].by} promoted it (SHA-256 "
            f"{hash_file(path)[:12]}, promoted {known[-1].sha256[:12]}); restore it, or promote it again"
        )
    return path


def add_promotion(
    model: Path, *, by: str, why: str, evidence: str, replaces: str | None, folder: Path = MODELS_FOLDER
) -> Promotion:
    """Copy a model and its card to the model registry as ``<card's name>-<hash>.onnx`` and make it the default.

    The caller has decided that the model may replace the default. Promoting the current default again changes nothing.

    Args:
        model: The ONNX file, with a card beside it or in its metadata.
        by: Who promotes it.
        why: The reason.
        evidence: The comparison that supports the promotion, as text.
        replaces: SHA-256 of the default that the model was compared with; None: there was no usable default.
        folder: Folder of the model registry.

    Returns:
        The new entry, or the existing one of the current default.

    Raises:
        ModelError: The model has no card, or another model was promoted since the comparison.
        StoreError: The folder cannot be written.
    """
    card = find_card(model)
    sha256 = hash_file(model)
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", card.name).strip("-.") or "model"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / f".{MODEL_LIST}.lock", timeout=_LOCK_TIMEOUT_S):
            known = read_promotions(folder)
            if known and known[-1].sha256 == sha256:
                return known[-1]
            if known and replaces not in (None, known[-1].sha256):
                raise ModelError(
                    f"{model} was compared with {str(replaces)[:12]}, but the default is {known[-1].sha256[:12]} "
                    f"since {known[-1].by} promoted it; compare with that one, then promote again"
                )
            entry = Promotion(
                file=f"{name}-{sha256[:12]}.onnx",
                sha256=sha256,
                promoted_at=datetime.now(UTC).replace(microsecond=0),
                by=by,
                why=why,
                replaces=replaces,
                evidence=evidence,
            )
            target = folder / entry.file
            locate_card(target).write_text(format_card(card), encoding="utf-8")
            _copy_model(model, target)
            _write_list(folder / MODEL_LIST, [*known, entry])
            return entry
    except (OSError, Timeout) as error:
        raise StoreError(
            f"the models' folder {folder} cannot be written: {error}; the default detector is unchanged: check the "
            "folder's permissions and free space, then promote again"
        ) from error


def _copy_model(source: Path, target: Path) -> None:
    """Copy atomically: ``target`` is complete or absent."""
    if source.resolve() == target.resolve():
        return
    part = target.with_name(f".{target.name}.part")
    shutil.copyfile(source, part)
    part.replace(target)


def _write_list(path: Path, entries: Sequence[Promotion]) -> None:
    content = yaml.safe_dump([entry.model_dump(mode="json") for entry in entries], sort_keys=False, allow_unicode=True)
    part = path.with_name(f".{path.name}.part")
    part.write_text(_HEADER + content, encoding="utf-8")
    part.replace(path)
