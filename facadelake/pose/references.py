"""Where the references of a building's campaigns are kept: beside the tables, one file a campaign."""

from __future__ import annotations

import shutil
import uuid
from pathlib import Path

REFERENCE = "reference.npz"


def _kept(lake: Path, building_id: str) -> Path:
    return lake / "references" / building_id


def earlier_references(lake: Path, building_id: str, campaign_id: str) -> list[Path]:
    """References of the building's campaigns whose id sorts before ``campaign_id``, the first campaign first."""
    folder = _kept(lake, building_id)
    return sorted(path for path in folder.glob("*.npz") if path.stem < campaign_id)


def keep_reference(made: Path, lake: Path, building_id: str, campaign_id: str) -> Path:
    """Keep the reference of a committed campaign in the lake's folder; an older one of the same campaign is replaced
    whole."""
    folder = _kept(lake, building_id)
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f".{campaign_id}.{uuid.uuid4().hex[:8]}.part"
    try:
        shutil.copyfile(made, part)
        kept = folder / f"{campaign_id}.npz"
        part.replace(kept)
    finally:
        part.unlink(missing_ok=True)
    return kept


def drop_reference(lake: Path, building_id: str, campaign_id: str) -> None:
    """Forget the reference of a campaign that was committed anew without one: its frame is no longer that one."""
    (_kept(lake, building_id) / f"{campaign_id}.npz").unlink(missing_ok=True)
