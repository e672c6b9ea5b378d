"""Campaigns whose photographs are put into their place directly, without an intake: whether they are settled."""

from __future__ import annotations

from dataclasses import dataclass

from pyarrow import fs
from sqlalchemy import Connection

from facadelake.core.errors import InputDataError
from facadelake.intake.ledger import open_ledger
from facadelake.intake.listing import compute_fingerprint, list_folder, sum_bytes
from facadelake.intake.observation_time import ObservationTime, read_clock
from facadelake.intake.observed_folders import FolderKey, observe_folder
from facadelake.intake.upload import UploadState, find_states
from facadelake.registry import Building, ServiceSettings

_PLACE = "photographs"


@dataclass(frozen=True, kw_only=True)
class CampaignObservation:
    """Whether the photographs of a campaign are settled: nothing is being written to their folder any more.

    ``explanation`` says why not, in words for a report; empty where they are. ``quiet_s`` is the time without a change
    as it was observed, by this and earlier calls.
    """

    is_settled: bool
    explanation: str
    files: int
    bytes: int
    quiet_s: float


def observe_campaign(
    building: Building, campaign_id: str, settings: ServiceSettings, at: ObservationTime | None = None
) -> CampaignObservation:
    """Observe the folder of a campaign's photographs, and say whether it is settled and can be inspected.

    It is where nothing in it has changed for ``settings.intake.quiet_minutes``, as observed by calls of this function
    and by ``receive_complete_uploads``, which observes the campaigns of all buildings. So the first
    call for a new folder says no. Times of change of the files are no evidence. A campaign that the building's intake
    received is settled as soon as it is there, unless more photographs of it are arriving.

    Args:
        building: the registered building.
        campaign_id: a campaign of ``building.list_campaigns()``.
        settings: of the service: its lake or database, where the ledger is, and the quiet time.
        at: the moment; None: now.

    Returns:
        the observation, which is recorded in the intake's ledger.

    Raises:
        InputDataError: the folder does not exist or cannot be listed.
        StoreError: the ledger cannot be read or written.
    """
    with open_ledger(settings).begin() as connection:
        return observe_in_ledger(building, campaign_id, settings, connection, at or read_clock())


def observe_in_ledger(
    building: Building, campaign_id: str, settings: ServiceSettings, connection: Connection, at: ObservationTime
) -> CampaignObservation:
    """As ``observe_campaign``, in a transaction of the ledger.

    Args:
        building: the registered building.
        campaign_id: its campaign.
        settings: of the service.
        connection: the transaction.
        at: the moment.

    Returns:
        the observation.

    Raises:
        InputDataError: the folder does not exist or cannot be listed.
        StoreError: the ledger cannot be read or written.
    """
    folder = building.locate_photographs(campaign_id)
    try:
        files = list_folder(fs.LocalFileSystem(), str(folder.resolve()))
    except OSError as error:
        raise InputDataError(
            f"the photographs' folder {folder} of building '{building.id}' cannot be listed ({error}); check that the "
            "disk is there, and that the service may read it"
        ) from error
    key = FolderKey(building_id=building.id, place=_PLACE, name=campaign_id)
    observed = observe_folder(connection, key, compute_fingerprint(files), at)
    states = find_states(connection, building.id, campaign_id)
    needed_s = settings.intake.quiet_minutes * 60
    arriving = sorted(folder for folder, state in states.items() if state is UploadState.GROWING)
    is_settled = bool(files) and not arriving and (bool(states) or observed.quiet_s >= needed_s)
    explanation = ""
    if not files:
        explanation = "its folder is empty"
    elif arriving:
        explanation = f"more photographs of it are arriving (upload '{arriving[0]}')"
    elif not is_settled:
        explanation = (
            f"its folder has been without a change for {observed.quiet_s / 60:.0f} of "
            f"{settings.intake.quiet_minutes:g} minutes as observed ({len(files)} files)"
        )
    return CampaignObservation(
        is_settled=is_settled,
        explanation=explanation,
        files=len(files),
        bytes=sum_bytes(files),
        quiet_s=observed.quiet_s,
    )
