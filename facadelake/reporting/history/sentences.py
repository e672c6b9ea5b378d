"""The parts of a comparison in words, the same on pages and in the terminal."""

from __future__ import annotations

from datetime import datetime

from facadelake.reporting.history.compared_track import ComparedTrack
from facadelake.reporting.history.comparison import BuildingComparison
from facadelake.reporting.history.relative_offsets import RelativeOffset
from facadelake.reporting.history.size_changes import format_size
from facadelake.severity import describe_severity
from schemas.vocabulary import StateEvidence

DAYS_PER_YEAR = 365.25
EVIDENCE = {
    StateEvidence.DETECTED: "detected",
    StateEvidence.LOOKS_THE_SAME: "not detected; its place looks as it did",
    StateEvidence.LOOKS_REPAIRED: "its place was imaged and looks different, without the defect",
    StateEvidence.LOOK_UNDECIDED: "its place was imaged; its look decides neither way",
    StateEvidence.HIDDEN: "something before the wall hides its place",
    StateEvidence.NOT_IN_VIEW: "no photograph shows its place well enough",
    StateEvidence.NO_PHOTOGRAPH: "not detected; the photographs for a look are not there",
    StateEvidence.PART_OF_OTHER: "found as a part of another defect",
    StateEvidence.REVIEW: "stated by a person",
}


def describe_evidence(track: ComparedTrack) -> str:
    """What the finding rests on besides a detection, and what else is known; empty where there is nothing to say."""
    evidence = "" if track.evidence is StateEvidence.DETECTED else EVIDENCE[track.evidence]
    return "; ".join(text for text in (evidence, track.remark) if text)


def describe_look(track: ComparedTrack, comparison: BuildingComparison) -> str:
    """Figures of the look at the place in the campaign that did not detect the defect; empty where there are none."""
    for campaign in (comparison.later, comparison.earlier):
        look = comparison.looks.get((campaign, track.track_id))
        if look is not None and look["look_similarity"] is not None:
            figures = [
                f"similarity within the defect's extents {look['look_similarity']:.2f}",
                None
                if look["surroundings_similarity"] is None
                else f"of the wall around it {look['surroundings_similarity']:.2f} (1: the same)",
                None
                if look["fading_extent"] is None
                else f"{100 * look['fading_extent']:.0f} % of the defect's diagonal faded into the wall",
            ]
            return f"look at the place in {campaign}: {', '.join(text for text in figures if text)}"
    return ""


def describe_sizes(track: ComparedTrack) -> tuple[str, str]:
    """The sizes of the detections that stand for both campaigns; one of another campaign is named."""
    # What a campaign between has of a defect that is gone now says nothing of the later one.
    after = track.after if track.is_there_later or track.before is None else None
    told = [
        format_size(row) + (f" in {row['campaign_id']}" if row is not None and row["campaign_id"] != name else "")
        for row, name in zip((track.before, after), track.pair, strict=True)
    ]
    return told[0], told[1]


def describe_class(track: ComparedTrack) -> str:
    """The class, and the one before where it was another."""
    if track.before is None or track.before["defect_class"] == track.defect_class:
        return track.defect_class
    return f"{track.before['defect_class']} → {track.defect_class}"


def describe_grade(track: ComparedTrack) -> str:
    """The severity with its range, and the one before where it was another."""
    grade = describe_severity(track.place)
    if track.before is None or track.before["severity"] == track.place["severity"]:
        return grade
    return f"{describe_severity(track.before)} → {grade}"


def describe_count(comparison: BuildingComparison) -> str:
    """How many defects one of both campaigns shows, and how many are in the comparison besides."""
    there = comparison.there_count
    others = len(comparison.tracks) - there
    text = f"{there} defect{'' if there == 1 else 's'} in {comparison.earlier} or {comparison.later}"
    return f"{text}, {others} more known from other campaigns" if others else text


def describe_place(track: ComparedTrack) -> str:
    """Facade, storey and element."""
    place = track.place
    parts = [place["facade"], place["storey"], place["element_name"] or place["ifc_class"]]
    return ", ".join(str(part) for part in parts if part)


def describe_span(comparison: BuildingComparison) -> str:
    """When both campaigns were photographed, and the time between."""
    times = [comparison.earlier_row["captured_from"], comparison.later_row["captured_from"]]
    days = [f"{time:%Y-%m-%d}" if isinstance(time, datetime) else "at an unknown date" for time in times]
    text = f"{comparison.earlier} photographed {days[0]}, {comparison.later} photographed {days[1]}"
    if None in times:
        return text
    return f"{text}: {(times[1] - times[0]).total_seconds() / 86400 / DAYS_PER_YEAR:.1f} years between"


def describe_offsets(comparison: BuildingComparison) -> str:
    """The offset between the frames of both campaigns in a sentence."""
    whole = comparison.offsets[0]
    if whole.xyz_m is None or whole.sigma_m is None:
        return f"The offset between the frames of both campaigns is not known: {whole.remark}."
    east, north, up = (f"{100 * x:+.1f} ± {100 * s:.1f} cm" for x, s in zip(whole.xyz_m, whole.sigma_m, strict=True))
    return (
        f"Positions of {comparison.later} are {east} east, {north} north and {up} up of those of {comparison.earlier}, "
        f"{_describe_counts(comparison, whole.counts)}. Defects are matched without this offset."
    )


def _describe_counts(comparison: BuildingComparison, counts: tuple[int, int]) -> str:
    told = [f"{count} of {name}" for count, name in zip(counts, (comparison.earlier, comparison.later), strict=True)
            if count]  # fmt: skip
    return f"estimated at defects known from campaigns before ({', '.join(told)})"


def format_offset(offset: RelativeOffset) -> tuple[str | None, str | None, str | None]:
    """East, north and up in cm with one sigma; None where not estimated."""
    if offset.xyz_m is None or offset.sigma_m is None:
        return None, None, None
    east, north, up = (f"{100 * x:+.1f} ± {100 * s:.1f}" for x, s in zip(offset.xyz_m, offset.sigma_m, strict=True))
    return east, north, up
