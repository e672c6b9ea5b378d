"""A clock that tests turn, and a portfolio of two buildings with an intake each, in a temporary folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from facadelake.intake.observation_time import ObservationTime
from facadelake.registry import Building, ServiceSettings
from facadelake.registry.service import IntakeLimits
from facadelake.registry.settings import IntakeSetting
from tests.unit.photos.small_photographs import photograph

START_S = 1_776_000_000.0  # 2026-04-12
LAT_DEG, LON_DEG = 48.9405, 8.4078


@dataclass
class TurnedClock:
    """A machine's clocks: that of the calendar, which can be set, and that of its start, which cannot."""

    unix_s: float = START_S
    boot_s: float = 1000.0
    boots: int = 1

    def __call__(self) -> ObservationTime:
        return ObservationTime(unix_s=self.unix_s, boot_id=f"boot-{self.boots}", boot_s=self.boot_s)

    def advance(self, *, minutes: float) -> None:
        self.unix_s += minutes * 60
        self.boot_s += minutes * 60

    def restart(self) -> None:
        """The machine starts anew."""
        self.boots += 1
        self.boot_s = 5.0


@dataclass(frozen=True)
class MadePlace:
    """Folders of a service with the buildings ``mill`` and ``tower``, 1.5 km apart."""

    root: Path
    marker: str | None = None
    clock: TurnedClock = field(default_factory=TurnedClock)

    @property
    def settings(self) -> ServiceSettings:
        return ServiceSettings(lake=str(self.root / "lake"), intake=IntakeLimits(quiet_minutes=30, stalled_days=3))

    def get_building(self, building_id: str = "mill") -> Building:
        return Building(
            id=building_id,
            name=building_id,
            model=f"{building_id}.ifc",
            photographs=str(self.root / "photographs" / building_id / "{campaign}"),
            intake=IntakeSetting(source=str(self.root / "uploads" / building_id), marker=self.marker),
        )

    @property
    def buildings(self) -> list[Building]:
        return [self.get_building("mill"), self.get_building("tower")]

    def upload(self, path: str, content: bytes, building_id: str = "mill") -> Path:
        """Write a file below a building's source."""
        file = self.root / "uploads" / building_id / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
        return file

    def upload_photographs(
        self, folder: str, seeds: range, building_id: str = "mill", taken: str = "2026:04:14 10:00:05"
    ) -> None:
        """Write photographs of the building that are named by their seeds."""
        north_deg = 0.0135 * (building_id == "tower")
        for seed in seeds:
            picture = photograph(LAT_DEG + north_deg, LON_DEG, seed=seed, taken=taken)
            self.upload(f"{folder}/DJI_{seed:04d}.JPG", picture, building_id)

    def list_received(self, campaign: str, building_id: str = "mill") -> list[str]:
        """What is in a campaign's folder of photographs, below it."""
        folder = self.root / "photographs" / building_id / campaign
        return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
