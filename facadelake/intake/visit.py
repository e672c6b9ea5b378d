"""One upload in one pass: what it waits for, whether it is received, and what the ledger then has of it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from sqlalchemy import Connection

from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.intake.answer import MarkerState, find_marker, read_answer
from facadelake.intake.completeness import Completeness, judge_number, judge_quiet
from facadelake.intake.file_kinds import LEFT_OUT, FileKind, classify_file, describe_left_out
from facadelake.intake.listing import ListedFile, compute_fingerprint, sum_bytes
from facadelake.intake.observation_time import ObservationTime
from facadelake.intake.observed_folders import ObservedFolder
from facadelake.intake.photograph_facts import FileFacts
from facadelake.intake.receive import CompleteUpload, Surroundings, UploadChangedError, receive_upload
from facadelake.intake.source import UploadSource
from facadelake.intake.upload import UploadRow, UploadState, load_row, save_facts, save_row
from facadelake.registry import Building, ServiceSettings

log = logging.getLogger(__name__)

_RETRY_FIRST_S = 300.0
_RETRY_LAST_S = 4 * 3600.0
_JUDGED_AGAIN_S = 3600.0  # the portfolio and the lake change, too
_REMARKS_MAX = 12


@dataclass(frozen=True, kw_only=True)
class UploadVisit:
    """An upload as one pass sees it."""

    building: Building
    source: UploadSource
    folder: str
    files: tuple[ListedFile, ...]
    observed: ObservedFolder
    at: ObservationTime

    @cached_property
    def fingerprint(self) -> str:
        """That of all its files, with the marker."""
        return compute_fingerprint(self.files)

    @cached_property
    def marker(self) -> MarkerState:
        """Its marker or answer."""
        return find_marker(self.building, self.files)

    @cached_property
    def content(self) -> tuple[ListedFile, ...]:
        """Its files without the marker."""
        name = self.marker.name
        return tuple(file for file in self.files if file.path != name)

    def count_photographs(self) -> int:
        """The number of its photographs and masks by their names."""
        return sum(classify_file(file) is FileKind.PHOTOGRAPH for file in self.content)


def visit_upload(visit: UploadVisit, settings: ServiceSettings, around: Surroundings) -> None:
    """Take an upload as far as it gets in this pass, and write that into the ledger.

    A problem of the upload becomes its state. Raises StoreError where the ledger cannot be read or written.
    """
    with around.ledger.begin() as connection:
        row = load_row(connection, visit.observed.id)
    row = row or UploadRow(state=UploadState.GROWING, state_since_s=visit.at.unix_s)
    current = replace(
        row,
        photographs=visit.count_photographs(),
        files=len(visit.content),
        bytes=sum_bytes(visit.content),
        in_source=True,
    )
    if row.received == visit.fingerprint:
        _save(visit, around, row, replace(current, state=UploadState.RECEIVED, reason=""))
        return
    facts: tuple[FileFacts, ...] = ()
    try:
        new, facts = _advance(visit, settings, around, current)
    except UploadChangedError as error:
        new = replace(current, state=UploadState.GROWING, reason=str(error))
    except (FacadelakeError, OSError) as error:
        new = _describe_failure(visit, current, str(error))
    except Exception as error:  # whatever a file leads to, it must not stop the other uploads at every pass
        log.exception("upload '%s' of building '%s'", visit.folder, visit.building.id)
        reason = f"unexpected {type(error).__name__}: {error}; please report this, with the service's log"
        new = _describe_failure(visit, current, reason)
    _save(visit, around, row, new, facts)


def record_unreadable(connection: Connection, folder_id: int, problem: str, at: ObservationTime) -> None:
    """Write into the ledger that the folder of an upload cannot be listed."""
    row = load_row(connection, folder_id) or UploadRow(state=UploadState.GROWING, state_since_s=at.unix_s)
    since_s = row.state_since_s if row.state is UploadState.FAILED else at.unix_s
    failed = replace(row, state=UploadState.FAILED, reason=problem, state_since_s=since_s, in_source=True)
    save_row(connection, folder_id, failed)


def _advance(
    visit: UploadVisit, settings: ServiceSettings, around: Surroundings, row: UploadRow
) -> tuple[UploadRow, tuple[FileFacts, ...]]:
    """The upload's row after this pass, and facts of its files for the ledger."""
    marker = visit.marker
    content = compute_fingerprint(visit.content)
    intake = visit.building.intake
    quiet_minutes = (intake.quiet_minutes if intake else None) or settings.intake.quiet_minutes
    stalled_days = settings.intake.stalled_days
    found = judge_quiet(
        visit.observed,
        marker,
        quiet_s=quiet_minutes * 60,
        stalled_days=stalled_days,
        is_answered=row.complete == content,
    )
    if not found.is_complete:
        return _describe_waiting(row, found), ()
    row = replace(row, complete=content)
    is_judged = row.state in (UploadState.FAILED, UploadState.REFUSED) and row.judged == visit.fingerprint
    if is_judged and visit.observed.quiet_s < row.retry_quiet_s:
        return row, ()
    refused = replace(
        row,
        state=UploadState.REFUSED,
        judged=visit.fingerprint,
        retry_quiet_s=visit.observed.quiet_s + _JUDGED_AGAIN_S,
        attempts=0,
    )
    try:
        answer = read_answer(visit.source, visit.folder, marker)
    except InputDataError as error:
        return replace(refused, reason=str(error)), ()
    number = visit.count_photographs()
    found = judge_number(visit.observed, answer, photographs=number, answer_file=marker.name, stalled_days=stalled_days)
    if not found.is_complete:
        return _describe_waiting(row, found), ()
    done = receive_upload(
        CompleteUpload(
            building=visit.building,
            source=visit.source,
            folder=visit.folder,
            folder_id=visit.observed.id,
            files=visit.content,
            listed=visit.files,
            answer=answer,
            answer_file=marker.name,
            campaign_id=row.campaign_id if row.received else None,
            examined=row.examined,
        ),
        around,
    )
    remarks = list(done.remarks)
    if answer.photographs is not None and number > answer.photographs:
        remarks.append(f"{number} photographs, of which its {marker.name} says that they are {answer.photographs}")
    if done.problems:
        reason = "; ".join(done.problems)
        told = tuple(remarks[:_REMARKS_MAX])
        campaign_id = row.campaign_id if row.received else done.campaign_id
        return replace(refused, reason=reason, remarks=told, campaign_id=campaign_id, examined=content), done.facts
    earlier = [line for line in row.remarks if row.received and not line.startswith(LEFT_OUT)]
    told = tuple(dict.fromkeys([*earlier, *remarks, *describe_left_out(visit.content)]))
    return (
        replace(
            row,
            state=UploadState.RECEIVED,
            reason="",
            remarks=told[-_REMARKS_MAX:],
            campaign_id=done.campaign_id,
            examined=content,
            received=visit.fingerprint,
            received_s=visit.at.unix_s,
            attempts=0,
        ),
        done.facts,
    )


def _describe_failure(visit: UploadVisit, row: UploadRow, reason: str) -> UploadRow:
    wait_s = min(_RETRY_FIRST_S * 2 ** min(row.attempts, 10), _RETRY_LAST_S)
    return replace(
        row,
        state=UploadState.FAILED,
        reason=reason,
        attempts=row.attempts + 1,
        complete=compute_fingerprint(visit.content),
        judged=visit.fingerprint,
        retry_quiet_s=visit.observed.quiet_s + wait_s,
    )


def _describe_waiting(row: UploadRow, found: Completeness) -> UploadRow:
    state = UploadState.STALLED if found.is_stalled else UploadState.GROWING
    return replace(row, state=state, reason=found.reason, attempts=0)


def _save(
    visit: UploadVisit, around: Surroundings, before: UploadRow, row: UploadRow, facts: Sequence[FileFacts] = ()
) -> None:
    since_s = before.state_since_s if row.state is before.state else visit.at.unix_s
    new = replace(row, state_since_s=since_s)
    if new == before and before.files and not facts:
        return
    with around.ledger.begin() as connection:
        save_row(connection, visit.observed.id, new)
        save_facts(connection, visit.observed.id, facts)
