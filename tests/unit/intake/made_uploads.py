"""A clock that tests turn, and a portfolio of two buildings with an intake each, in a temporary folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from facadelake.intake import IntakeReport, Upload, receive_complete_uploads
from facadelake.intake.observation_time import ObservationTime
from facadelake.registry import Building, ServiceSettings
from facadelake.registry.service import IntakeLimits
from facadelake.registry.settings import BuildingCrs, IntakeSetting, SiteOriginSetting
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
    """Folders of a service with the buildings ``mill`` and ``tower``, by default 1.5 km apart.

    ``origins``: whether the portfolio says where they are.
    """

    root: Path
    marker: str | None = None
    origins: bool = False
    apart_deg: float = 0.0135
    sources: str = "uploads"
    clock: TurnedClock = field(default_factory=TurnedClock)

    @property
    def settings(self) -> ServiceSettings:
        return ServiceSettings(lake=str(self.root / "lake"), intake=IntakeLimits(quiet_minutes=30, stalled_days=3))

    def get_building(self, building_id: str = "mill") -> Building:
        lat_deg = LAT_DEG + self.apart_deg * (building_id == "tower")
        origin = SiteOriginSetting(lon_deg=LON_DEG, lat_deg=lat_deg, height_ellipsoidal_m=180.0)
        return Building(
            crs=BuildingCrs(origin=origin if self.origins else None),
            id=building_id,
            name=building_id,
            model=f"{building_id}.ifc",
            photographs=str(self.root / "photographs" / building_id / "{campaign}"),
            intake=IntakeSetting(source=str(self.root / self.sources / building_id), marker=self.marker),
        )

    def run_pass(self, minutes: float = 5) -> IntakeReport:
        """A pass, some time after the one before."""
        self.clock.advance(minutes=minutes)
        return receive_complete_uploads(self.buildings, self.settings, self.clock)

    def run_until_quiet(self) -> IntakeReport:
        """Two passes with the quiet time between them: what does not change is complete then."""
        self.run_pass()
        return self.run_pass(minutes=30)

    @property
    def buildings(self) -> list[Building]:
        return [self.get_building("mill"), self.get_building("tower")]

    def upload(self, path: str, content: bytes, building_id: str = "mill") -> Path:
        """Write a file below a building's source; the disk for photographs is there."""
        (self.root / "photographs").mkdir(exist_ok=True)
        file = self.root / self.sources / building_id / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
        return file

    def upload_photographs(
        self, folder: str, seeds: range, building_id: str = "mill", taken: str = "2026:04:14 10:00:05"
    ) -> None:
        """Write photographs of the building that are named by their seeds."""
        north_deg = self.apart_deg * (building_id == "tower")
        for seed in seeds:
            picture = photograph(LAT_DEG + north_deg, LON_DEG, seed=seed, taken=taken)
            self.upload(f"{folder}/DJI_{seed:04d}.JPG", picture, building_id)

    def list_received(self, campaign: str, building_id: str = "mill") -> list[str]:
        """What is in a campaign's folder of photographs, below it."""
        folder = self.root / "photographs" / building_id / campaign
        return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def get_upload(report: IntakeReport, folder: str, building_id: str = "mill") -> Upload:
    """The upload of a folder."""
    (found,) = [one for one in report.uploads if (one.building_id, one.folder) == (building_id, folder)]
    return found
