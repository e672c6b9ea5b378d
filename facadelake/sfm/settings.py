"""Settings of the reconstruction; part of its cache key."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from typing import Any

from facadelake.core.errors import InputDataError


@dataclass(frozen=True, kw_only=True)
class ReconstructionSettings:
    """How the photographs are brought together.

    ``max_image_px``: features are found on photographs reduced to this longer side; ``max_features`` of them at most
    in each. ``exhaustive_up_to``: up to that many photographs every pair is tried, above it ``neighbours`` of each by
    position and viewing direction, and half as many by their looks where positions say too little, and as many again of
    those partners' partners. ``threads`` 0: all cores, or as many as the free memory bears. ``seed`` fixes what is
    drawn at random.
    """

    max_image_px: int = 2000
    max_features: int = 8192
    exhaustive_up_to: int = 30
    neighbours: int = 16
    threads: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        limits = {"max_image_px": 400, "max_features": 500, "exhaustive_up_to": 2, "neighbours": 2, "threads": 0}
        for name, least in limits.items():
            if getattr(self, name) < least:
                raise InputDataError(
                    f"reconstruction setting {name} is {getattr(self, name)}; it must be {least} or more"
                )

    @property
    def cores(self) -> int:
        """Threads to use."""
        return self.threads or os.cpu_count() or 1

    def key(self) -> dict[str, Any]:
        """What changes the result, for the cache: the number of threads is left out."""
        return {name: value for name, value in asdict(self).items() if name != "threads"}
