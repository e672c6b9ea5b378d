"""Positions of a file matched to the photographs of a campaign, and compared with the photographs' own metadata."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.photos.coordinate_mistakes import measure_apart_m, name_mistake
from facadelake.photos.position_prior import PositionPrior
from facadelake.photos.positions_file.table import PositionFile
from schemas.vocabulary import HeightDatum, PositionSource

# The file and the metadata come from different solutions: beyond this many sigmas of their difference they disagree.
_DISAGREE_SIGMAS = 3.0
_LISTED_MAX = 5


@dataclass(frozen=True, kw_only=True)
class MatchedPositions:
    """The positions by photo_id, and what the user has to know: lines and names not used, photographs not named."""

    by_photo: Mapping[str, PositionPrior]
    remarks: tuple[str, ...]


def match_positions(file: PositionFile, photo_ids: Sequence[str]) -> MatchedPositions:
    """Match the names of a file to the photographs of a campaign. Raises InputDataError where none matches."""
    by_photo: dict[str, PositionPrior] = {}
    unknown: list[str] = []
    for name, match in PhotoNames(photo_ids).match_all(file.positions).items():
        if match.photo_id is None:
            unknown.append(match.reason)
        else:
            by_photo[match.photo_id] = file.positions[name]
    if not by_photo:
        raise InputDataError(
            f"none of the {len(file.positions)} names in the positions file {file.path} is a photograph of the "
            f"campaign ({unknown[0]}); give the file of this campaign, with the photographs' file names"
        )
    unnamed = [photo_id for photo_id in photo_ids if photo_id not in by_photo]
    remarks = [
        f"{file.path.name}: {len(entries)} {what}: {'; '.join(entries[:_LISTED_MAX])}"
        + (f" and {len(entries) - _LISTED_MAX} more" if len(entries) > _LISTED_MAX else "")
        for what, entries in (
            ("lines are not used", list(file.problems)),
            ("names are no photographs of the campaign", unknown),
            ("photographs are not in it, whose own metadata are used", unnamed),
        )
        if entries
    ]
    return MatchedPositions(by_photo=by_photo, remarks=(*file.remarks, *remarks))


def compare_with_metadata(by_file: PositionPrior, by_metadata: PositionPrior) -> PositionPrior:
    """The position of a file, with a warning where that of the photograph's own metadata disagrees with it."""
    if by_metadata.source is PositionSource.NONE:
        return by_file
    file_place, own_place = (by_file.lon_deg, by_file.lat_deg), (by_metadata.lon_deg, by_metadata.lat_deg)
    apart_m = measure_apart_m(file_place, own_place)
    limit_m = _DISAGREE_SIGMAS * math.hypot(by_file.sigma.horizontal_m, by_metadata.sigma.horizontal_m)
    warnings = []
    source = by_metadata.source.upper()
    if apart_m > limit_m:
        mistake = name_mistake(file_place, own_place)
        warnings.append(
            f"the position of the file (lat {by_file.lat_deg:.8f}, lon {by_file.lon_deg:.8f}) is {apart_m:.2f} m from "
            f"that of {source} (lat {by_metadata.lat_deg:.8f}, lon {by_metadata.lon_deg:.8f}), beyond three sigmas of "
            f"their difference ({limit_m:.2g} m){f', as with {mistake}' if mistake else ''}; the file is used, as the "
            "portfolio says"
        )
    same_datum = by_file.height_datum is by_metadata.height_datum is not HeightDatum.UNKNOWN
    apart_m = abs(by_file.height_m - by_metadata.height_m)
    limit_m = _DISAGREE_SIGMAS * math.hypot(by_file.sigma.vertical_m, by_metadata.sigma.vertical_m)
    if same_datum and apart_m > limit_m:
        warnings.append(
            f"the height of the file, {by_file.height_m:.2f} m, is {apart_m:.2f} m from {by_metadata.height_m:.2f} m "
            f"of {source}, beyond three sigmas of their difference ({limit_m:.2g} m); the file is used, as the "
            "portfolio says"
        )
    return replace(by_file, warnings=(*by_file.warnings, *warnings))
