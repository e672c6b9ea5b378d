"""The positions that count for a campaign, as the portfolio says."""

from __future__ import annotations

from facadelake.photos.files import explain_unsupported, find_photographs
from facadelake.photos.position_sigma import PositionSigma
from facadelake.photos.positions_file.matching import match_positions
from facadelake.photos.positions_file.table import PositionFile, PositionFileFormat, read_position_file
from facadelake.registry import Building
from schemas.vocabulary import PositionSource


def read_registered_positions(building: Building, campaign_id: str) -> PositionSource | PositionFile | None:
    """XMP or EXIF, the positions of the file that the portfolio names, or None where it says nothing.

    Raises InputDataError where the file does not exist or is not readable.
    """
    setting, path = building.positions, building.locate_positions(campaign_id)
    if setting is None:
        return None
    if path is None:
        return PositionSource(setting.source)
    sigma = None
    if setting.sigma_horizontal_m is not None and setting.sigma_vertical_m is not None:
        sigma = PositionSigma(horizontal_m=setting.sigma_horizontal_m, vertical_m=setting.sigma_vertical_m)
    return read_position_file(
        path, PositionFileFormat(columns=setting.columns, vertical=setting.vertical or "", sigma=sigma)
    )


def list_position_remarks(building: Building, campaign_id: str) -> tuple[str, ...]:
    """Lines and names of the positions file that are not used, and photographs that it does not name.

    Raises InputDataError where the file is not usable.
    """
    positions = read_registered_positions(building, campaign_id)
    if not isinstance(positions, PositionFile):
        return ()
    root = building.locate_photographs(campaign_id)
    photo_ids = [path.relative_to(root).as_posix() for path in find_photographs(root) if not explain_unsupported(path)]
    return match_positions(positions, photo_ids).remarks
