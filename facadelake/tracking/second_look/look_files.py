"""Looks as files, so that they are made once for two campaigns."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from facadelake.tracking.second_look.comparison import Comparison
from facadelake.tracking.second_look.fading import Fading
from facadelake.tracking.second_look.look import Look
from schemas.vocabulary import LookVerdict

_FILE = "looks.json"


def write_look_files(looks: Sequence[Look], folder: Path) -> None:
    """Write looks, and their pictures beside them, into a folder."""
    rows = []
    for number, look in enumerate(looks):
        picture = f"{number:05d}.jpg" if look.picture is not None else None
        if picture is not None and look.picture is not None:
            (folder / picture).write_bytes(look.picture)
        rows.append({**asdict(look), "picture": picture})
    (folder / _FILE).write_text(json.dumps(rows))


def read_look_files(folder: Path) -> list[Look]:
    """The looks that ``write_look_files`` wrote into a folder."""
    looks = []
    for row in json.loads((folder / _FILE).read_text()):
        key, ids, counts = row["key"], row["photo_ids"], row["photo_counts"]
        looks.append(
            Look(
                key=(key[0], key[1], key[2]),
                verdict=LookVerdict(row["verdict"]),
                photo_ids=(ids[0], ids[1]),
                photo_counts=(counts[0], counts[1]),
                comparison=_read_comparison(row["comparison"]),
                picture=None if row["picture"] is None else (folder / row["picture"]).read_bytes(),
                remark=row["remark"],
            )
        )
    return looks


def _read_comparison(values: dict[str, Any] | None) -> Comparison | None:
    return None if values is None else Comparison(**{**values, "fading": Fading(**values["fading"])})
