"""What contradicts an upload: when and where its photographs were taken, and whether they were received before.

A check returns problems, which refuse the upload until a person answers, and remarks, which are told. Photographs are
compared by their own statements; one that states nothing is not held against the upload.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median

import pyproj

from facadelake.intake.answer import UploadAnswer
from facadelake.intake.campaign_name import Period
from facadelake.intake.photograph_facts import FileFacts

# Strays are told; beyond this share of the photographs the upload is refused.
_STRAY_SHARE = 0.1
_DUPLICATE_SHARE = 0.9
_SPAN_MAX_DAYS = 92
# Positions of photographs are of some metres, origins of models lie up to some hundred metres beside their building.
_REACH_M = 500.0
_NEXT_DOOR_M = 50.0
_NEARER = 3.0
_ELLIPSOID = pyproj.Geod(ellps="WGS84")


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Problems and remarks of a check."""

    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def join(self, other: Findings) -> Findings:
        """Both together."""
        return Findings(problems=self.problems + other.problems, remarks=self.remarks + other.remarks)


@dataclass(frozen=True, kw_only=True)
class BuildingPlace:
    """Where a building is (WGS 84), and how that is known."""

    lon_deg: float
    lat_deg: float
    evidence: str


@dataclass(frozen=True, kw_only=True)
class KnownPhotographs:
    """Photographs of another upload or campaign, by the hashes of their contents."""

    name: str
    sha256: frozenset[str]


def check_dates(
    period: Period | None, facts: Sequence[FileFacts], answer: UploadAnswer, *, answer_file: str, now: datetime
) -> Findings:
    """Compare the capture dates with the date in the upload's or the campaign's name, and with one another.

    Args:
        period: the date that was stated; None: none.
        facts: the photographs.
        answer: what a person accepts.
        answer_file: where he writes it.
        now: the present day, as no photograph is from the future.

    Returns:
        what contradicts.
    """
    times = sorted(one.taken_at for one in facts if one.taken_at is not None)
    photographs = sum(one.is_photograph and not one.problem for one in facts)
    if not times:
        return Findings(remarks=("no photograph has a capture time; its date is not compared",) if photographs else ())
    taken = _format_span(times)
    accept = f"write 'accept: [dates]' into {answer_file}"
    found: list[str] = []
    remarks: list[str] = []
    future = [time for time in times if time > now + timedelta(days=2)]
    if future:
        found.append(
            f"{len(future)} of {len(times)} photographs were taken in the future ({_format_span(future)}; today is "
            f"{now:%Y-%m-%d}): correct the capture times, which the camera's clock gave, or {accept}"
        )
    if period is not None:
        strays = [time for time in times if not period.is_within(time)]
        line = (
            f"{len(strays)} of {len(times)} photographs were taken {_format_span(strays) if strays else ''}, which is "
            f"not {period.text} (by more than {period.tolerance_days} days)"
        )
        if len(strays) > _STRAY_SHARE * len(times):
            found.append(
                f"{line}: name the folder by its date ({taken}), move photographs of another campaign away, or, if "
                f"{period.text} is right and the camera's clock was wrong, {accept}"
            )
        elif strays:
            remarks.append(line)
    else:
        cut = round(_STRAY_SHARE / 2 * len(times))
        inner = times[cut : len(times) - cut] or times
        if (inner[-1] - inner[0]).days > _SPAN_MAX_DAYS:
            found.append(
                f"its photographs were taken {taken}, over more than {_SPAN_MAX_DAYS} days, and its folder's name says "
                f"no date: put each campaign into a folder of its own, such as {times[-1]:%Y-%m}, or {accept}"
            )
    if "dates" in answer.accept:
        return Findings(remarks=(*(f"accepted: {line}" for line in found), *remarks))
    return Findings(problems=tuple(found), remarks=tuple(remarks))


def _format_span(times: Sequence[datetime]) -> str:
    first, last = min(times), max(times)
    return f"on {first:%Y-%m-%d}" if first.date() == last.date() else f"from {first:%Y-%m-%d} to {last:%Y-%m-%d}"


def check_position(
    building_id: str,
    facts: Sequence[FileFacts],
    places: Mapping[str, BuildingPlace],
    answer: UploadAnswer,
    *,
    answer_file: str,
) -> Findings:
    """Compare the photographs' positions with the places of the registered buildings.

    Args:
        building_id: the building whose source the upload is in.
        facts: the photographs.
        places: where buildings are, by their ids, as far as that is known.
        answer: what a person accepts.
        answer_file: where he writes it.

    Returns:
        what contradicts.
    """
    positions = [(one.lon_deg, one.lat_deg) for one in facts if one.has_position]
    if not positions:
        return Findings(remarks=("no photograph has a position: not compared with the place of the building",))
    distances = {name: _measure_m(positions, place) for name, place in places.items()}
    own = places.get(building_id)
    if own is None:
        return Findings(remarks=(_describe_unplaced(distances, len(positions)),))
    strays = []
    nearest: Counter[str] = Counter()
    for index, distance_m in enumerate(distances[building_id]):
        others = {name: values[index] for name, values in distances.items() if name != building_id}
        other = min(others, key=others.__getitem__, default="")
        is_at_other = bool(other) and others[other] * _NEARER < distance_m and distance_m > _NEXT_DOOR_M
        if distance_m > _REACH_M or is_at_other:
            strays.append(index)
            if other and others[other] <= _REACH_M:
                nearest[other] += 1
    if not strays:
        return Findings()
    away_m = median(distances[building_id][index] for index in strays)
    line = (
        f"{len(strays)} of {len(positions)} photographs with a position were taken {away_m:,.0f} m from building "
        f"'{building_id}' (median; place by {own.evidence}; limit {_REACH_M:.0f} m, or nearer to another building)"
    )
    remedy = "check which building they show"
    if nearest:
        name, count = nearest.most_common(1)[0]
        there_m = median(distances[name][index] for index in strays)
        line += f", {count} of them near building '{name}' ({there_m:,.0f} m)"
        remedy = f"move them to the source of '{name}'"
    if len(strays) <= _STRAY_SHARE * len(positions):
        return Findings(remarks=(line,))
    if "position" in answer.accept:
        return Findings(remarks=(f"accepted: {line}",))
    return Findings(
        problems=(
            f"{line}: {remedy}, or, if they do show '{building_id}', write 'accept: [position]' into {answer_file}",
        )
    )


def _describe_unplaced(distances: Mapping[str, Sequence[float]], count: int) -> str:
    """What is known of photographs of a building whose own place is unknown."""
    line = "the place of the building is not known yet: positions are not compared"
    away_m = {name: median(values) for name, values in distances.items()}
    nearest = min(away_m, key=away_m.__getitem__, default="")
    if nearest and away_m[nearest] <= _REACH_M:
        line += f" with it; building '{nearest}' is {away_m[nearest]:,.0f} m from them (median of {count})"
    return line


def _measure_m(positions: Sequence[tuple[float, float]], place: BuildingPlace) -> list[float]:
    lon_deg, lat_deg = zip(*positions, strict=True)
    count = len(positions)
    _, _, distance_m = _ELLIPSOID.inv(lon_deg, lat_deg, [place.lon_deg] * count, [place.lat_deg] * count)
    return [float(one) for one in distance_m]


def check_duplicates(
    facts: Sequence[FileFacts], known: Sequence[KnownPhotographs], answer: UploadAnswer, *, answer_file: str
) -> Findings:
    """Compare the photographs' contents with those of other uploads and campaigns.

    Args:
        facts: the photographs.
        known: those that were received or inspected before, elsewhere.
        answer: what a person accepts.
        answer_file: where he writes it.

    Returns:
        what contradicts.
    """
    hashes = {one.sha256 for one in facts if one.is_photograph}
    problems: list[str] = []
    remarks: list[str] = []
    for other in known:
        shared = len(hashes & other.sha256)
        if not shared:
            continue
        line = f"{shared} of {len(hashes)} photographs are those of {other.name}"
        if shared < _DUPLICATE_SHARE * len(hashes):
            remarks.append(line)
        elif "duplicate" in answer.accept:
            remarks.append(f"accepted: {line}")
        else:
            problems.append(
                f"{line}: remove this upload, or, if they are to be inspected again as a campaign of their own, write "
                f"'accept: [duplicate]' into {answer_file}"
            )
    return Findings(problems=tuple(problems), remarks=tuple(remarks))
