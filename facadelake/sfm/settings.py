"""Settings of the reconstruction; part of its cache key."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from typing import Any

from facadelake.core.errors import InputDataError


@dataclass(frozen=True, kw_only=True)
class ReconstructionSettings:
    """Settings of structure from motion.

    ``max_image_px``: features are extracted from photographs reduced to this longer side; ``max_features``: at most in
    each. ``exhaustive_up_to``: up to this many photographs every pair is matched; above it each is matched with
    ``neighbours`` others by position and viewing direction. Where positions are uncertain, half as many are added by
    appearance, and as many again from the verified partners of those. ``threads`` 0: all cores, or as many as the free
    memory allows. ``seed`` is that of all random sampling.
    """

    max_image_px: int = 2000
    max_features: int = 8192
    exhaustive_up_to: int = 30
    neighbours: int = 16
    threads: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        limits = {"max_image_px": 400, "max_features": 500, "exhaustive_up_to": 2, "neighbours": 2, "threads": 0}
        for name, minimum in limits.items():
            if getattr(self, name) < minimum:
                raise InputDataError(
                    f"reconstruction setting {name} is {getattr(self, name)}; it must be {minimum} or more"
                )

    @property
    def cores(self) -> int:
        """Number of threads."""
        return self.threads or os.cpu_count() or 1

    @property
    def cache_key(self) -> dict[str, Any]:
        """The settings that change the result, for cache keys: all but the number of threads."""
        return {name: value for name, value in asdict(self).items() if name != "threads"}
