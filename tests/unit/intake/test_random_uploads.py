"""Uploads in pieces, renames, late photographs, lost ledgers and passes in any order: each photograph is received once.

What a pass receives is all of an upload that has not changed for the quiet time, never a part of it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from facadelake.intake import UploadState
from tests.unit.intake.made_uploads import LAT_DEG, LON_DEG, MadePlace
from tests.unit.photos.small_photographs import photograph

QUIET_MINUTES = 30


class RandomUploads(RuleBasedStateMachine):
    """One building; each campaign of ours is photographs of one month, in a folder that may be renamed."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.place = MadePlace(Path(self.folder.name))
        self.names: dict[int, str] = {}  # folder of each month
        self.sent: dict[int, set[str]] = {}
        self.changed_at: dict[int, float] = {}
        self.seed = 0

    @initialize()
    def begin(self) -> None:
        (self.place.root / "uploads" / "mill").mkdir(parents=True)
        (self.place.root / "uploads" / "tower").mkdir(parents=True)

    @rule(month=st.integers(1, 3), count=st.integers(1, 2))
    def send(self, month: int, count: int) -> None:
        for _ in range(count):
            self.seed += 1
            taken = f"2026:{month:02d}:14 10:00:00"
            picture = photograph(LAT_DEG, LON_DEG, seed=self.seed, taken=taken)
            name = f"DJI_{self.seed:04d}.JPG"
            self.place.upload(f"{self.names.setdefault(month, f'folder {month}')}/{name}", picture)
            self.sent.setdefault(month, set()).add(name)
            self.changed_at[month] = self.place.clock.boot_s

    @precondition(lambda self: self.names)
    @rule(data=st.data())
    def rename(self, data: st.DataObject) -> None:
        month = data.draw(st.sampled_from(sorted(self.names)))
        name = data.draw(st.sampled_from([f"folder {month}", f"2026-{month:02d}", f"2026-{month:02d} mill"]))
        if name != self.names[month]:
            source = self.place.root / "uploads" / "mill"
            (source / self.names[month]).rename(source / name)
            self.names[month] = name
            self.changed_at[month] = self.place.clock.boot_s

    def list_received(self) -> dict[int, set[str]]:
        campaigns = self.place.get_building().list_campaigns()
        return {int(one.split("-")[1]): set(self.place.list_received(one)) for one in campaigns}

    @rule(minutes=st.sampled_from([1, 10, 29, 31]))
    def observe(self, minutes: int) -> None:
        before = self.list_received()
        self.place.run_pass(minutes=minutes)
        for month, received in self.list_received().items():
            if received != before.get(month):
                assert received == self.sent[month]
                assert self.place.clock.boot_s - self.changed_at[month] >= QUIET_MINUTES * 60

    @rule(hours=st.sampled_from([-30, 30]))
    def set_clock(self, hours: int) -> None:
        self.place.clock.unix_s += hours * 3600

    @rule()
    def lose_the_ledger(self) -> None:
        (self.place.root / "lake" / "intake.sqlite").unlink(missing_ok=True)

    def teardown(self) -> None:
        """In the end all photographs of each month are in one campaign, and the ledger says so."""
        for _ in range(3):
            report = self.place.run_pass(minutes=31)
        present = [one for one in report.uploads if one.in_source]
        assert {one.folder for one in present} == set(self.names.values())
        for one in present:
            assert one.state is UploadState.RECEIVED, (one.folder, one.reason)
        for month, names in self.sent.items():
            assert self.place.list_received(f"2026-{month:02d}") == sorted(names)
        assert len(self.place.get_building().list_campaigns()) == len(self.sent)
        self.folder.cleanup()


RandomUploads.TestCase.settings = settings(
    max_examples=25, stateful_step_count=12, deadline=None, suppress_health_check=list(HealthCheck)
)
TestRandomUploads = RandomUploads.TestCase
