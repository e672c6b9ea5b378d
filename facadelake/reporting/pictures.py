"""Pictures of a committed campaign: cards of defects, elevations of facades, overlays of photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from facadelake.building.surface import Surface
from facadelake.campaigns import read_committed_model, read_committed_tables
from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import get_stage_schema
from facadelake.registry import Building
from facadelake.reporting.cards.cards import draw_cards
from facadelake.reporting.distribution import (
    compute_distribution,
    draw_distribution,
    format_distribution_title,
    write_distribution,
)
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.elevations.elevation import (
    draw_elevations,
    find_drawn_facades,
    map_defects_to_elevations,
    map_defects_to_model,
)
from facadelake.reporting.elevations.facades import DIRECTIONS
from facadelake.reporting.inspection import Inspection, PictureSettings
from facadelake.reporting.overlays import draw_overlays, select_overlay_photographs
from facadelake.reporting.severity_order import sort_by_severity


@dataclass(frozen=True, kw_only=True)
class PictureSelection:
    """The pictures to be drawn: cards by defect_id, elevations by facade, overlays by photo_id, the distribution."""

    defect_ids: tuple[str, ...] = ()
    facades: tuple[str, ...] = ()
    photo_ids: tuple[str, ...] = ()
    distribution: bool = False


@dataclass(frozen=True, kw_only=True)
class DrawnPictures:
    """Files written, and photographs that are missing or unreadable."""

    paths: tuple[Path, ...]
    missing: tuple[str, ...]


def select_by_name(
    inspection: Inspection,
    surface: Surface,
    *,
    defects: Sequence[str],
    facades: Sequence[str],
    photos: Sequence[str],
    settings: PictureSettings,
) -> PictureSelection:
    """Selection by names in full or short form.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        defects: defect_ids, their last parts or their labels on elevations, such as "D0012" or "12".
        facades: facades as in column ``facade``, or their directions in words: "SE" or "south-east".
        photos: photo_ids or file names with or without suffix, such as "IMG_0009".
        settings: settings of the pictures, which determine the facades that are drawn.

    Raises:
        InputDataError: a name is unknown; the message lists similar names.
    """
    defect_ids = inspection.defects.column("defect_id").to_pylist()
    labels = {label: name for name, label in label_ids(defect_ids).items()}
    ends = _invert_unique({name: name.rsplit("-", 1)[-1] for name in defect_ids})
    files = inspection.photos.column("photo_id").to_pylist()
    photo_names = PhotoNames(files)
    drawn = [facade.name for facade in find_drawn_facades(inspection, surface, settings)] if facades else []
    return PictureSelection(
        defect_ids=tuple(_match_name(name, "defect", defect_ids, labels | ends) for name in defects),
        facades=tuple(_match_name(name, "facade", drawn, _index_facade_names(drawn)) for name in facades),
        photo_ids=tuple(_match_photograph(name, photo_names, files) for name in photos),
    )


def select_all(inspection: Inspection, surface: Surface, settings: PictureSettings) -> PictureSelection:
    """All defects, all facades that are drawn, all localised photographs."""
    return PictureSelection(
        defect_ids=tuple(inspection.defects.column("defect_id").to_pylist()),
        facades=tuple(facade.name for facade in find_drawn_facades(inspection, surface, settings)),
        photo_ids=tuple(sorted(inspection.posed)),
        distribution=True,
    )


def select_report_pictures(inspection: Inspection, surface: Surface, settings: PictureSettings) -> PictureSelection:
    """The pictures of the report: the most severe defects, all facades, some overlays, the distribution."""
    worst = sort_by_severity(inspection.defects)[: settings.report_cards]
    return PictureSelection(
        defect_ids=tuple(row["defect_id"] for row in worst),
        facades=tuple(facade.name for facade in find_drawn_facades(inspection, surface, settings)),
        photo_ids=tuple(select_overlay_photographs(inspection, settings.report_overlays)),
        distribution=True,
    )


def draw_selection(
    inspection: Inspection, surface: Surface, selection: PictureSelection, folder: Path, settings: PictureSettings
) -> DrawnPictures:
    """Write the selected pictures; files of an earlier call are overwritten, others are kept.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        selection: pictures to be drawn.
        folder: folder to write into: ``cards/``, ``elevations/``, ``overlays/``, ``distribution.png`` and ``.csv``.
        settings: resolution and limits.
    """
    paths: list[Path] = []
    missing: set[str] = set()
    if selection.distribution:
        folder.mkdir(parents=True, exist_ok=True)
        distribution = compute_distribution(inspection)
        paths.append(
            draw_distribution(distribution, format_distribution_title(inspection), folder / "distribution.png")
        )
        paths.append(write_distribution(distribution, folder / "distribution.csv"))
    elevations = []
    if selection.facades:
        (folder / "elevations").mkdir(parents=True, exist_ok=True)
        elevations = draw_elevations(inspection, surface, folder / "elevations", settings, selection.facades)
        paths += [elevation.path for elevation in elevations]
        paths += [elevation.coverage_path for elevation in elevations if elevation.coverage_path is not None]
        missing |= {name for name in inspection.posed if not inspection.locate_photograph(name).is_file()}
    if selection.defect_ids:
        overviews = map_defects_to_elevations(elevations)
        others = [name for name in selection.defect_ids if name not in overviews]
        if others:
            facades = find_drawn_facades(inspection, surface, settings)
            overviews |= map_defects_to_model(inspection, surface, facades, others)
        cards = draw_cards(
            inspection, surface, selection.defect_ids, folder / "cards", overviews=overviews,
            max_observations=settings.card_observations,
        )  # fmt: skip
        paths += [cards.paths[name] for name in selection.defect_ids]
        missing |= set(cards.missing)
    if selection.photo_ids:
        (folder / "overlays").mkdir(parents=True, exist_ok=True)
        overlays = draw_overlays(inspection, surface, selection.photo_ids, folder / "overlays", settings)
        paths += overlays.values()
        missing |= set(selection.photo_ids) - overlays.keys()
    return DrawnPictures(paths=tuple(dict.fromkeys(paths)), missing=tuple(sorted(missing)))


def _invert_unique(short_names: Mapping[str, str]) -> dict[str, str]:
    """Full names by short names, without short names of several full names."""
    all_short = list(short_names.values())
    return {short: name for name, short in short_names.items() if all_short.count(short) == 1}


def _index_facade_names(names: Sequence[str]) -> dict[str, str]:
    """Facades by the words of their direction: "south-east" for "SE"."""
    return _invert_unique({name: DIRECTIONS[name.partition("-")[0].partition("_")[0]] for name in names})


def _match_photograph(name: str, photo_names: PhotoNames, photo_ids: Sequence[str]) -> str:
    """The photo_id that ``name`` refers to; raises InputDataError with the candidates and similar names."""
    match = photo_names.match(name)
    if match.photo_id is not None:
        return match.photo_id
    near = get_close_matches(name, photo_ids, n=4, cutoff=0.5)
    total = "" if near else f" (of {len(photo_ids)})"
    raise InputDataError(
        f"unknown photograph: {match.reason}; similar names: {', '.join(near or photo_ids[:4]) or 'none'}{total}"
    )


def _match_name(name: str, kind: str, names: Sequence[str], short_names: Mapping[str, str]) -> str:
    """The full name that ``name`` stands for, ignoring case; raises InputDataError with similar names."""
    if name in names:
        return name
    by_lower = {other.lower(): full for other, full in (*short_names.items(), *((full, full) for full in names))}
    if name.lower() in by_lower:
        return by_lower[name.lower()]
    near = get_close_matches(name.lower(), list(by_lower), n=4, cutoff=0.5)
    similar = list(dict.fromkeys(by_lower[other] for other in near)) or list(names[:4])
    if not similar:
        raise InputDataError(f"unknown {kind} '{name}': the campaign has none")
    total = "" if near else f" (of {len(names)})"
    raise InputDataError(f"unknown {kind} '{name}' in this campaign; similar names: {', '.join(similar)}{total}")


_TABLES = (
    "photos", "poses", "georeference", "georeference_points", "placement_checks", "detections", "observations",
    "defects", "merges", "integrity_views", "coverage", "checks",
)  # fmt: skip


def draw_pictures(
    building: Building,
    campaign_id: str,
    *,
    lake: Path,
    folder: Path,
    defects: tuple[str, ...] = (),
    facades: tuple[str, ...] = (),
    photos: tuple[str, ...] = (),
    draw_all: bool = False,
    as_of: int | None = None,
) -> DrawnPictures:
    """Draw pictures of a committed campaign; without names, those of the report.

    Tables are read from the lake, photographs and building model from the portfolio.

    Args:
        building: building in the portfolio.
        campaign_id: campaign.
        lake: folder of the lake.
        folder: folder to write into.
        defects: defects whose cards are drawn, by full or short names.
        facades: facades whose elevations are drawn, by name or compass point.
        photos: photographs whose overlays are drawn, by photo_id or file name.
        draw_all: draw all defects, facades and localised photographs; the names are ignored.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        StoreError: the lake does not contain the campaign.
        InputDataError: a name is unknown, or the model in the portfolio is not the one of the campaign.
    """
    inspection = _read_inspection(building, campaign_id, lake, as_of)
    surface = Surface(inspection.building)
    settings = PictureSettings()
    if draw_all:
        selection = select_all(inspection, surface, settings)
    elif defects or facades or photos:
        selection = select_by_name(
            inspection, surface, defects=defects, facades=facades, photos=photos, settings=settings
        )
    else:
        selection = select_report_pictures(inspection, surface, settings)
    return draw_selection(inspection, surface, selection, folder, settings)


def _read_inspection(building: Building, campaign_id: str, lake: Path, as_of: int | None) -> Inspection:
    committed = read_committed_tables(building, campaign_id, _TABLES, lake=lake, as_of=as_of)
    tables = {name: committed[name].select(get_stage_schema(name).names) for name in _TABLES}
    return Inspection(
        building_name=building.name,
        campaign_id=campaign_id,
        photographs_root=building.locate_photographs(campaign_id),
        building=read_committed_model(building, campaign_id, committed["buildings"].to_pylist()[0]),
        posed=read_posed_cameras(tables["poses"]),
        placement_sigma_max_m=building.tolerances.placement_sigma_max_m,
        **tables,
    )
