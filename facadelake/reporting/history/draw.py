"""The comparison of two committed campaigns written as a folder: its page, elevations and pairs of pictures."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.campaigns import read_committed_model
from facadelake.core.errors import InputDataError, ModelError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.progress import report_progress
from facadelake.lake import has_lake, read_tables
from facadelake.registry import Building
from facadelake.reporting.cards.crops import format_file_label
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.elevations.marks import DefectMark, create_marks
from facadelake.reporting.history.compared_track import ComparedTrack
from facadelake.reporting.history.comparison import READ_COLUMNS, TABLES, BuildingComparison, Row, compare_campaigns
from facadelake.reporting.history.elevations import draw_elevation_pictures
from facadelake.reporting.history.page import ComparisonPictures, write_page
from facadelake.reporting.history.pairs import PairRequest, PosedPhotographs, write_pairs
from facadelake.reporting.inspection import PictureSettings
from schemas.tables import LAKE_TABLES
from schemas.vocabulary import SurfaceKind

PAIRS_MAX = 150
_FAR_M = 1e6


@dataclass(frozen=True, kw_only=True, eq=False)
class BuildingTables:
    """Tables of a building of one version of the lake, by name."""

    building_id: str
    lake: Path
    version: int | None
    tables: Mapping[str, pa.Table]


def read_history(lake: Path, building_id: str, names: Sequence[str] = TABLES, *, as_of: int | None) -> BuildingTables:
    """The tables ``names`` of a building; raises InputDataError where the lake does not have the building.

    Args:
        lake: folder of the lake.
        building_id: the building.
        names: tables.
        as_of: an earlier version of the lake; None: the newest.
    """
    if not has_lake(lake):
        raise InputDataError(f"there is no lake in {lake}; inspect a campaign first, or name another with --lake")
    with report_progress("Reading the lake"):
        tables = read_tables(lake, list(names), building_id=building_id, as_of=as_of, columns=READ_COLUMNS)
    if not len(tables["campaigns"]):
        raise InputDataError(f"the lake {lake} has no campaign of building '{building_id}'; run 'facadelake inspect'")
    return BuildingTables(building_id=building_id, lake=lake, version=as_of, tables=tables)


def compare_committed(
    lake: Path, building_id: str, earlier: str | None, later: str | None, *, as_of: int | None
) -> tuple[BuildingComparison, BuildingTables]:
    """Compare two committed campaigns of a building.

    Args:
        lake: folder of the lake.
        building_id: the building.
        earlier: the earlier campaign; None: the one before ``later``.
        later: the later campaign; None: the latest by capture time.
        as_of: an earlier version of the lake; None: the newest.

    Returns:
        The comparison, and the tables that pictures of it need.
    """
    history = read_history(lake, building_id, (*TABLES, "buildings", "poses"), as_of=as_of)
    return compare_campaigns(history.tables, earlier, later), history


def write_comparison(
    comparison: BuildingComparison,
    history: BuildingTables,
    building: Building | None,
    folder: Path,
    pairs_max: int = PAIRS_MAX,
) -> Path:
    """Write the page of a comparison with its pictures into ``folder``; files of an earlier call are overwritten.

    Args:
        comparison: the comparison.
        history: the tables it was made from.
        building: the building in the portfolio, which names photographs and model; None: it is not registered.
        folder: folder to write into; created.
        pairs_max: largest number of tracks with a pair of pictures.

    Returns:
        The page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    committed = {row["campaign_id"]: row for row in history.tables["buildings"].to_pylist()}
    pictures = _draw(comparison, history, building, committed, folder, pairs_max)
    pictures = replace(pictures, cards=_find_cards(comparison, history, folder, pairs_max))
    return write_page(comparison, pictures, str(committed[comparison.later]["building_name"]), folder)


def _draw(
    comparison: BuildingComparison,
    history: BuildingTables,
    building: Building | None,
    committed: Mapping[str, Row],
    folder: Path,
    pairs_max: int,
) -> ComparisonPictures:
    """Draw elevations and pairs.

    Args:
        comparison: the comparison.
        history: the tables it was made from.
        building: the building in the portfolio.
        committed: rows of table ``buildings`` by campaign.
        folder: folder to write into.
        pairs_max: largest number of pairs.
    """
    origin = read_origin(committed[comparison.later])
    names = (comparison.earlier, comparison.later)
    sources = [read_photographs(history, building, name, origin) for name in names]
    model, surface, remark = read_surface(building, comparison.later, committed[comparison.later])
    marks = create_track_marks(
        [track.place for track in comparison.tracks], [t.track_id for t in comparison.tracks], origin
    )
    elevations = []
    if model is not None:
        elevations = draw_elevation_pictures(
            model, surface, sources[1], list(marks.values()), folder / "elevations", PictureSettings()
        )
    requests = [create_request(track, comparison, marks[track.track_id]) for track in comparison.listed[:pairs_max]]
    return ComparisonPictures(
        elevations=elevations,
        pairs=write_pairs(requests, sources[0], sources[1], surface, folder / "pairs"),
        cards={},
        shown_max=pairs_max,
        remark=remark,
    )


def read_photographs(
    history: BuildingTables, building: Building | None, campaign_id: str, origin: SiteOrigin
) -> PosedPhotographs:
    """Poses and folder of a campaign's photographs.

    Args:
        history: tables campaigns, buildings and poses.
        building: the building in the portfolio, which says where the photographs are; None: where they were.
        campaign_id: the campaign.
        origin: origin of the site frame into which the poses are moved, where the campaign's own is another one.
    """
    own = {
        name: history.tables[name].filter(pc.equal(history.tables[name]["campaign_id"], campaign_id))
        for name in ("campaigns", "buildings", "poses")
    }
    site_from_own = origin.ecef_from_site().invert() @ read_origin(own["buildings"].to_pylist()[0]).ecef_from_site()
    root = (
        own["campaigns"].column("photographs_uri").to_pylist()[0]
        if building is None
        else building.photographs.replace("{campaign}", campaign_id)
    )
    return PosedPhotographs(
        campaign_id=campaign_id,
        posed={
            photo_id: replace(posed, site_from_cam=site_from_own @ posed.site_from_cam)
            for photo_id, posed in read_posed_cameras(own["poses"]).items()
        },
        root=Path(root),
    )


def read_origin(committed: Row) -> SiteOrigin:
    """Origin of the site frame of a campaign, from its row of table ``buildings``."""
    return SiteOrigin(
        lon_deg=committed["origin_lon_deg"],
        lat_deg=committed["origin_lat_deg"],
        height_ellipsoidal_m=committed["origin_height_ellipsoidal_m"],
    )


def read_surface(
    building: Building | None, campaign_id: str, committed: Row
) -> tuple[BuildingModel | None, Surface, str]:
    """The model and its surface; without a model a surface that no ray meets, and a remark that says why."""
    if building is None:
        reason = f"the portfolio does not have building '{committed['building_id']}', so its model is not known"
    elif building.surface_kind is SurfaceKind.AS_BUILT:
        reason = "the building has no model"
    else:
        try:
            model = read_committed_model(building, campaign_id, committed)
            return model, Surface(model), ""
        except (InputDataError, ModelError) as error:
            reason = str(error)
    far = np.array([[0.0, 0.0, _FAR_M], [1.0, 0.0, _FAR_M], [0.0, 1.0, _FAR_M]])
    remark = (
        f"No elevations: {reason}. Pictures are rectified onto the plane of each defect, and what hides the wall is "
        "not considered."
    )
    return None, Surface.from_mesh(far, np.array([[0, 1, 2]])), remark


def create_track_marks(places: Sequence[Row], track_ids: Sequence[str], origin: SiteOrigin) -> dict[str, DefectMark]:
    """Marks by track, which stand for the defects of their places; ``defect_id`` is the track's.

    Positions are taken from longitude, latitude and height, because the site frames of campaigns may differ.

    Args:
        places: rows of table ``defects``.
        track_ids: the tracks.
        origin: origin of the site frame.
    """
    labels = label_ids(sorted(track_ids))
    geo = np.array([[row[name] for name in ("lon_deg", "lat_deg", "height_ellipsoidal_m")] for row in places])
    xyz = origin.site_from_geo(geo.reshape(-1, 3))
    rows = [
        {**row, **dict(zip(("x_site_m", "y_site_m", "z_site_m"), point, strict=True))}
        for row, point in zip(places, xyz.tolist(), strict=True)
    ]
    marks = create_marks(pa.Table.from_pylist(rows, LAKE_TABLES["defects"].arrow), origin)
    return {
        name: replace(mark, defect_id=name, label=labels[name]) for name, mark in zip(track_ids, marks, strict=True)
    }


def create_request(track: ComparedTrack, comparison: BuildingComparison, mark: DefectMark) -> PairRequest:
    """The pair of pictures of a track: the best photographs of its defects, else those that were looked at."""
    offsets = {offset.facade: offset.xyz_m for offset in comparison.offsets if offset.xyz_m is not None}
    offset = offsets.get(track.place["facade"] or "", offsets.get("", (0.0, 0.0, 0.0)))
    photo_ids: list[str | None] = []
    for campaign in track.pair:
        defect = track.find_detection(campaign)
        look = comparison.looks.get((campaign, track.track_id))
        photo_ids.append(defect["best_photo_id"] if defect is not None else look["look_photo_id"] if look else None)
    return PairRequest(
        track_id=track.track_id,
        mark=mark,
        photo_ids=(photo_ids[0], photo_ids[1]),
        in_later=track.place["campaign_id"] == comparison.later,
        offset_m=np.array(offset, dtype=np.float64),
    )


def _find_cards(
    comparison: BuildingComparison, history: BuildingTables, folder: Path, shown_max: int
) -> dict[tuple[str, str], str]:
    """Links to the cards in the published releases, by campaign and defect, of the tracks that are shown."""
    rows = history.tables["defects"].select(["campaign_id", "defect_id"]).to_pylist()
    links: dict[tuple[str, str], str] = {}
    for campaign in (comparison.earlier, comparison.later):
        release = find_release(history.lake, comparison.building_id, campaign, history.version)
        if release is None:
            continue
        labels = label_ids([row["defect_id"] for row in rows if row["campaign_id"] == campaign])
        for track in comparison.listed[:shown_max]:
            defect = track.find_detection(campaign)
            if defect is None:
                continue
            card = release / "cards" / f"card_{format_file_label(labels[defect['defect_id']])}.png"
            if card.is_file():
                links[campaign, defect["defect_id"]] = link_outside(card, folder)
    return links


def locate_comparison(lake: Path, building_id: str, earlier: str, later: str, version: int | None = None) -> Path:
    """The folder of a comparison's page in the lake.

    Args:
        lake: folder of the lake.
        building_id: the building.
        earlier: the earlier campaign.
        later: the later campaign.
        version: an earlier version of the lake, which has a folder of its own; None: the newest.
    """
    newest = lake / "comparisons" / building_id / f"{earlier}_to_{later}"
    return newest if version is None else newest / f"v{version:06d}"


def find_release(lake: Path, building_id: str, campaign_id: str, version: int | None) -> Path | None:
    """The newest published release of a campaign up to a version of the lake; None where there is none."""
    folder = lake / "published" / building_id / campaign_id
    found = sorted(path for path in folder.glob("v[0-9]*") if path.is_dir() and path.name[1:].isdigit())
    kept = [path for path in found if version is None or int(path.name[1:]) <= version]
    return kept[-1] if kept else None


def link_outside(path: Path, folder: Path) -> str:
    """URL of a file from a page in ``folder``: relative, so that the lake can be moved as a whole."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return path.resolve().as_uri()
