"""What the service remembers of a building between runs: since when it is registered, and attempts that failed.

One JSON file a building in ``<lake>/portfolio/buildings/``, beside the lake and not in it: the lake holds what was
committed, and a campaign that was refused has no rows there. A failure that the same photographs, files, settings and
code lead to again is not tried every night; a file of its own can be read, copied with the lake, and deleted to have
everything tried anew. Writing is atomic, and one inspection of the portfolio runs at a time.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from facadelake.core.errors import StoreError

PORTFOLIO_FOLDER = "portfolio"
_TRIES_OF_CRASHES = 3

AttemptOutcome = Literal["refused", "failed", "killed"]


class FailedAttempt(BaseModel):
    """The last failed attempt at a campaign: ``fingerprint`` is of all that it was made of, ``tries`` how often.

    ``refused``: the input is at fault, and is again. ``failed`` and ``killed`` (by a signal): the machine may be.
    """

    model_config = ConfigDict(frozen=True)

    outcome: AttemptOutcome
    fingerprint: str
    tries: int
    at: datetime
    problem: str
    peak_mib: float | None = None

    def explain_no_retry(self, fingerprint: str) -> str:
        """Why the campaign is not tried again with ``fingerprint``; empty: it is."""
        if fingerprint != self.fingerprint:
            return ""
        if self.outcome == "refused":
            return f"refused on {self.at:%Y-%m-%d} and nothing has changed since: {self.problem}"
        if self.tries >= _TRIES_OF_CRASHES:
            return (
                f"failed {self.tries} times, last on {self.at:%Y-%m-%d}, and nothing has changed since: {self.problem}"
            )
        return ""


class BuildingLog(BaseModel):
    """What is remembered of a building.

    ``compared``: by campaign the listing of its photographs that was found to be that in the lake, so that equal sizes
    with newer dates are hashed once. ``told_overdue`` are the dates that a notification was sent for.
    """

    registered_at: datetime
    attempts: dict[str, FailedAttempt] = {}
    compared: dict[str, str] = {}
    told_overdue: list[str] = []

    def record_failure(
        self,
        campaign_id: str,
        *,
        outcome: AttemptOutcome,
        fingerprint: str,
        problem: str,
        peak_mib: float | None,
        at: datetime,
    ) -> None:
        """Remember a failed attempt.

        Args:
            campaign_id: the campaign.
            outcome: whose fault it is.
            fingerprint: of all that the attempt was made of.
            problem: the message.
            peak_mib: the memory that it took, as far as measured.
            at: when it ended.
        """
        before = self.attempts.get(campaign_id)
        tries = before.tries + 1 if before is not None and before.fingerprint == fingerprint else 1
        self.attempts[campaign_id] = FailedAttempt(
            outcome=outcome, fingerprint=fingerprint, tries=tries, at=at, problem=problem, peak_mib=peak_mib
        )

    def clear_failure(self, campaign_id: str) -> None:
        """Forget the failed attempts at a campaign: it was committed."""
        self.attempts.pop(campaign_id, None)


def read_building_log(lake: Path, building_id: str, now: datetime) -> BuildingLog:
    """What is remembered of a building; one that is seen for the first time is registered ``now``.

    Raises StoreError where the file cannot be read.
    """
    path = _locate_log(lake, building_id)
    try:
        return BuildingLog.model_validate_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return BuildingLog(registered_at=now.astimezone(UTC))
    except (OSError, ValidationError, UnicodeDecodeError) as error:
        raise StoreError(
            f"{path} cannot be read ({str(error).splitlines()[0]}); it is begun anew: campaigns that failed before are "
            "tried again"
        ) from error


def write_building_log(lake: Path, building_id: str, log: BuildingLog) -> None:
    """Write what is remembered of a building."""
    path = _locate_log(lake, building_id)
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    draft.write_text(log.model_dump_json(indent=1), encoding="utf-8")
    draft.replace(path)


def _locate_log(lake: Path, building_id: str) -> Path:
    return lake / PORTFOLIO_FOLDER / "buildings" / f"{building_id}.json"
