"""Sites of the pictures and splits of the sites, from sites.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

from facadelake.core.errors import FacadelakeError
from facadelake.reviews.training import Split

SITES_PATH = Path(__file__).with_name("sites.yaml")


@dataclass(frozen=True, kw_only=True)
class Site:
    """A place, or a series of pictures that cannot be divided further, of one set; `stems`: names of its pictures."""

    name: str
    split: Split
    surface: str
    stems: tuple[str, ...]


@cache
def read_sites(set_name: str, path: Path = SITES_PATH) -> Mapping[str, Site]:
    """Sites of one set of `data/defects`, by name of the picture without suffix.

    Raises FacadelakeError if a picture is in two sites, which may have different splits.
    """
    listed = yaml.safe_load(path.read_text(encoding="utf-8"))
    if set_name not in listed:
        raise FacadelakeError(f"{path}: no set {set_name!r}; it has {', '.join(listed)}")
    by_stem: dict[str, Site] = {}
    for name, entry in listed[set_name].items():
        site = Site(
            name=f"{set_name}/{name}",
            split=Split(entry["split"]),
            surface=entry["surface"],
            stems=tuple(str(stem) for stem in entry["pictures"]),
        )
        for stem in site.stems:
            if stem in by_stem:
                raise FacadelakeError(
                    f"{path}: {stem} of {set_name} is in {by_stem[stem].name} and in {site.name}; remove it from one"
                )
            by_stem[stem] = site
    return by_stem
