"""One complete upload: copied, examined, and received as a campaign, or refused with all that contradicts it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path

from facadelake.core.errors import FacadelakeError, InputDataError, StoreError
from facadelake.intake.answer import UploadAnswer
from facadelake.intake.campaign_name import Period, find_period, name_campaign, name_campaign_by_dates
from facadelake.intake.checks import (
    BuildingPlace,
    Findings,
    KnownPhotographs,
    check_dates,
    check_duplicates,
    check_position,
)
from facadelake.intake.file_kinds import FileKind, classify_file
from facadelake.intake.known import (
    find_campaign_photographs,
    find_inspected,
    find_places,
    find_received,
    hash_photographs,
)
from facadelake.intake.ledger import Ledger
from facadelake.intake.listing import ListedFile, compute_fingerprint
from facadelake.intake.photograph_facts import FileFacts, collect_facts
from facadelake.intake.source import UploadSource
from facadelake.intake.staging import StagedCopy, add_files, copy_to_staging, find_changed, place_new, remove_staged
from facadelake.intake.upload import load_facts
from facadelake.registry import Building

_SAME_SHARE = 0.9
_LISTED_MAX = 3


class UploadChangedError(StoreError):
    """An upload changed while it was copied; nothing was received."""


@dataclass(frozen=True, kw_only=True)
class CompleteUpload:
    """A complete upload to be received: where it is, what it holds, and what a person says of it.

    ``campaign_id``: the campaign that it was received as before; None: it is new. ``examined``: the fingerprint that
    the ledger's facts of its files are of.
    """

    building: Building
    source: UploadSource
    folder: str
    folder_id: int
    files: tuple[ListedFile, ...]
    listed: tuple[ListedFile, ...]
    answer: UploadAnswer
    answer_file: str
    campaign_id: str | None
    examined: str


@dataclass(frozen=True, kw_only=True)
class Reception:
    """What became of a complete upload: received as ``campaign_id``, or refused for ``problems``.

    ``facts`` are those of the files that were not received before, for the ledger.
    """

    campaign_id: str | None
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    facts: tuple[FileFacts, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What an upload is compared with: the lake, the ledger, the places of all buildings, the present day (UTC)."""

    ledger: Ledger
    lake: Path
    buildings: tuple[Building, ...]
    now: datetime

    @cached_property
    def places(self) -> Mapping[str, BuildingPlace]:
        """Where buildings are; the lake is asked where an upload is complete, and once."""
        return find_places(self.buildings, self.lake)


def receive_upload(upload: CompleteUpload, around: Surroundings) -> Reception:
    """Receive a complete upload, or say what contradicts it.

    Its new files are copied beside their place, compared with the source once more, and examined. The campaign's folder
    appears by one rename. The facts of the files stay in the ledger, so that an upload that was refused is judged again
    at every pass without being read.

    Raises UploadChangedError where it changed meanwhile, StoreError where it cannot be read or written.
    """
    with around.ledger.begin() as connection:
        known = load_facts(connection, upload.folder_id)
    fingerprint = compute_fingerprint(upload.files)
    wanted = [
        file
        for file in upload.files
        if classify_file(file) in (FileKind.PHOTOGRAPH, FileKind.BESIDE)
        if not (file.path in known and known[file.path].is_received and known[file.path].file == file)
    ]
    staged: StagedCopy | None = None
    try:
        if upload.examined == fingerprint and all(file.path in known for file in wanted):
            facts = [known[file.path] for file in wanted]
        else:
            staged, facts = _copy_and_examine(upload, wanted, fingerprint)
        judged = _judge(upload, facts, around)
        gone = {path for path, one in known.items() if one.is_received} - {file.path for file in upload.files}
        if gone and upload.campaign_id is not None:
            line = f"{len(gone)} file{'s' * (len(gone) > 1)} went from the source; what was received stays"
            judged = replace(judged, remarks=(*judged.remarks, line))
        if judged.problems or not facts:
            return replace(judged, facts=tuple(facts))
        if staged is None:
            staged, facts = _copy_and_examine(upload, wanted, fingerprint)
        return _put_in_place(upload, facts, staged, judged)
    finally:
        if staged is not None:
            remove_staged(staged)


def _copy_and_examine(
    upload: CompleteUpload, wanted: Sequence[ListedFile], fingerprint: str
) -> tuple[StagedCopy, list[FileFacts]]:
    parent = upload.building.locate_campaigns()
    staged = copy_to_staging(upload.source, upload.folder, wanted, parent=parent, fingerprint=fingerprint)
    changed = find_changed(upload.source, upload.folder, staged, upload.listed)
    if changed:
        remove_staged(staged)
        raise UploadChangedError(f"it changed while it was copied ({_format_names(changed)}); it is waited for again")
    try:
        return staged, collect_facts(staged.folder, wanted, staged.sha256_of)
    except FacadelakeError:  # a copy that is wrong is not to be gone on with
        remove_staged(staged)
        raise


def _judge(upload: CompleteUpload, facts: Sequence[FileFacts], around: Surroundings) -> Reception:
    """The campaign of an upload, and all that contradicts it."""
    photographs = [one for one in facts if one.is_photograph]
    unreadable = [one for one in photographs if one.problem]
    if not photographs:
        if upload.campaign_id is not None:  # nothing but files beside them, or files that went
            return Reception(campaign_id=upload.campaign_id)
        return Reception(campaign_id=None, problems=("it has no photographs; put them into this folder",))
    if len(unreadable) == len(photographs):
        problem = f"none of its {len(photographs)} photographs can be read ({unreadable[0].problem})"
        return Reception(campaign_id=None, problems=(problem,))
    campaign_id, period, found = _identify(upload, photographs)
    if unreadable:
        names = _format_names([f"{one.file.path} ({one.problem})" for one in unreadable])
        found = found.join(Findings(remarks=(f"{len(unreadable)} photographs cannot be read: {names}",)))
    answer, answer_file = upload.answer, upload.answer_file
    found = found.join(check_dates(period, photographs, answer, answer_file=answer_file, now=around.now))
    own = upload.building.id
    found = found.join(check_position(own, photographs, around.places, answer, answer_file=answer_file))
    found = found.join(_compare_with_others(upload, campaign_id, photographs, around))
    return Reception(campaign_id=campaign_id, problems=found.problems, remarks=found.remarks)


def _identify(upload: CompleteUpload, photographs: Sequence[FileFacts]) -> tuple[str | None, Period | None, Findings]:
    """The campaign id, the date that was stated for it, and what is to be said of that."""
    told = upload.answer.campaign
    if upload.campaign_id is not None:
        if told not in (None, upload.campaign_id):
            problem = (
                f"it was received as campaign {upload.campaign_id}, and its {upload.answer_file} says {told}: put "
                f"photographs of {told} into a folder of their own, or correct the file"
            )
            return upload.campaign_id, None, Findings(problems=(problem,))
        told = upload.campaign_id
    try:
        if told is not None:
            return told, find_period(told), Findings()
        known = upload.building.list_campaigns()
        named = name_campaign(upload.folder, known)
        if named is not None:
            return named, find_period(upload.folder), Findings()
    except InputDataError as error:
        return told, None, Findings(problems=() if told else (str(error),))
    times = [one.taken_at for one in photographs if one.taken_at is not None]
    if not times:
        problem = (
            f"neither its folder's name '{upload.folder}' nor its photographs say when they were taken: rename the "
            f"folder, such as to 2026-04, or write 'campaign: 2026-04' into {upload.answer_file}"
        )
        return None, None, Findings(problems=(problem,))
    by_dates = name_campaign_by_dates(times, known)
    remark = f"campaign {by_dates} by its capture dates, as the folder's name '{upload.folder}' has no date"
    return by_dates, None, Findings(remarks=(remark,))


def _compare_with_others(
    upload: CompleteUpload, campaign_id: str | None, photographs: Sequence[FileFacts], around: Surroundings
) -> Findings:
    """Whether the photographs were received or inspected before, or the campaign is there already."""
    own = frozenset(one.sha256 for one in photographs)
    with around.ledger.begin() as connection:
        received = find_received(connection, own, upload.folder_id)
    this = (upload.building.id, campaign_id)
    others = [one for one in received if one.in_source or (one.building_id, one.campaign_id) != this]
    known = [
        KnownPhotographs(
            name=f"upload '{one.folder}' of building '{one.building_id}', received as campaign {one.campaign_id}",
            sha256=one.sha256,
        )
        for one in others
    ]
    listed = {this, *((one.building_id, one.campaign_id) for one in others)}
    known += [
        KnownPhotographs(name=f"campaign {campaign} of building '{building}' in the lake", sha256=hashes)
        for (building, campaign), hashes in sorted(find_inspected(own, around.lake).items())
        if (building, campaign) not in listed
    ]
    found = check_duplicates(photographs, known, upload.answer, answer_file=upload.answer_file)
    if campaign_id is None or upload.campaign_id is not None or found.problems:
        return found
    there = hash_photographs(upload.building.place_photographs(campaign_id))
    there = there or find_campaign_photographs(upload.building.id, campaign_id, around.lake)
    shared = len(own & there)
    is_same = shared >= _SAME_SHARE * min(len(own), len(there)) and not any(one.in_source for one in others)
    if not there or is_same or "addition" in upload.answer.accept:
        return found
    problem = (
        f"campaign {campaign_id} is there already, with {len(there)} photographs, {shared} of which are among the "
        f"{len(own)} of this upload: rename the folder, such as to {campaign_id}-2, or, if it belongs to that "
        f"campaign, write 'accept: [addition]' into {upload.answer_file}"
    )
    return found.join(Findings(problems=(problem,)))


def _put_in_place(
    upload: CompleteUpload, facts: Sequence[FileFacts], staged: StagedCopy, judged: Reception
) -> Reception:
    assert judged.campaign_id is not None  # without one there is a problem
    target = upload.building.place_photographs(judged.campaign_id)
    if upload.campaign_id is None and not (target.is_dir() and any(target.iterdir())):
        place_new(staged, target)
        return replace(judged, facts=tuple(replace(one, is_received=True) for one in facts))
    if not target.is_dir():
        raise StoreError(
            f"more photographs arrived for campaign {judged.campaign_id}, whose folder {target} is gone; restore it, "
            "or put all its photographs into a new folder of the source"
        )
    is_addition = "addition" in upload.answer.accept
    is_replaced = "changed" in upload.answer.accept
    done = add_files(
        staged,
        [one.file.path for one in facts],
        target / upload.folder if is_addition else target,
        replace_changed=is_replaced,
    )
    remarks = list(judged.remarks)
    if done.added:
        remarks.append(f"{len(done.added)} files were added to campaign {judged.campaign_id}")
    if done.completed:
        remarks.append(f"completed, as they had been received in part: {_format_names(done.completed)}")
    if done.changed:
        remarks.append(
            f"received before with another content, and {'replaced' if is_replaced else 'left as they were'}: "
            f"{_format_names(done.changed)}"
        )
        if not is_replaced:
            remarks[-1] += (
                "; other photographs belong into a folder of their own, newer ones of the same replace them with "
                f"'accept: [changed]' in {upload.answer_file}"
            )
    left = () if is_replaced else done.changed
    return replace(
        judged,
        remarks=tuple(remarks),
        facts=tuple(replace(one, is_received=one.file.path not in left) for one in facts),
    )


def _format_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED_MAX} more" if len(names) > _LISTED_MAX else ""
    return ", ".join(names[:_LISTED_MAX]) + more
