"""Which picture belongs to which site, and which sites are learned from: sites.yaml, read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

from facadelake.core.errors import FacadelakeError
from training.data.sample import Split

SITES_PATH = Path(__file__).with_name("sites.yaml")


@dataclass(frozen=True, kw_only=True)
class Site:
    """One place, or one series that cannot be told apart further, of one set; `stems` are its pictures' names."""

    name: str
    split: Split
    surface: str
    stems: tuple[str, ...]


@cache
def sites_of(set_name: str, path: Path = SITES_PATH) -> Mapping[str, Site]:
    """Picture name without ending -> its site, for one set of `data/defects`.

    Raises FacadelakeError when a picture is named in two sites: it would be learned from and judged by.
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
                    f"{path}: {stem} of {set_name} is in {by_stem[stem].name} and in {site.name}; keep one"
                )
            by_stem[stem] = site
    return by_stem
