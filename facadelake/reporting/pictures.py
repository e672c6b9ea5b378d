"""Pictures of a committed campaign by name: cards of defects, elevations of facades, overlays of photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path, PurePosixPath

from facadelake.building.surface import Surface
from facadelake.campaigns import read_committed_model, read_committed_tables
from facadelake.core.errors import InputDataError
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
from facadelake.reporting.inspection import Inspection, PictureSettings
from facadelake.reporting.overlays import draw_overlays, select_overlay_photographs
from facadelake.reporting.page.defects import sort_by_severity


@dataclass(frozen=True, kw_only=True)
class PictureSelection:
    """What is to be drawn: ids of defects, names of facades, ids of photographs; and whether the distribution is."""

    defect_ids: tuple[str, ...] = ()
    facades: tuple[str, ...] = ()
    photo_ids: tuple[str, ...] = ()
    distribution: bool = False


@dataclass(frozen=True, kw_only=True)
class DrawnPictures:
    """Files that were written, and the photographs that are not there or cannot be read."""

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
    """Names as people write them, such as "D0012" or "12", "south", "IMG_0009".

    Raises InputDataError for one that there is not, with those that are near it.
    """
    known = inspection.defects.column("defect_id").to_pylist()
    labels = {label: name for name, label in label_ids(known).items()}
    ends = _invert_unique({name: name.rsplit("-", 1)[-1] for name in known})
    files = inspection.photos.column("photo_id").to_pylist()
    stems = _invert_unique({name: PurePosixPath(name).stem for name in files})
    names = _invert_unique({name: PurePosixPath(name).name for name in files})
    sheets = [facade.name for facade in find_drawn_facades(inspection, surface, settings)] if facades else []
    return PictureSelection(
        defect_ids=tuple(_match_name(word, "defect", known, labels | ends) for word in defects),
        facades=tuple(_match_name(word, "facade", sheets, _index_facade_names(sheets)) for word in facades),
        photo_ids=tuple(_match_name(word, "photograph", files, stems | names) for word in photos),
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
    """The worst defects, all facades, a few photographs, the distribution."""
    worst = sort_by_severity(inspection.defects)[: settings.report_cards]
    return PictureSelection(
        defect_ids=tuple(row["defect_id"] for row in worst),
        facades=tuple(facade.name for facade in find_drawn_facades(inspection, surface, settings)),
        photo_ids=tuple(select_overlay_photographs(inspection, settings.report_overlays)),
        distribution=True,
    )


def draw_selection(
    inspection: Inspection, surface: Surface, wanted: PictureSelection, folder: Path, settings: PictureSettings
) -> DrawnPictures:
    """Write what is wanted into ``folder``: ``cards/``, ``elevations/``, ``overlays/``, ``distribution.png`` and
    ``.csv``. Files of an earlier call are written over, others stay."""
    paths: list[Path] = []
    gone: set[str] = set()
    if wanted.distribution:
        folder.mkdir(parents=True, exist_ok=True)
        found = compute_distribution(inspection)
        paths.append(draw_distribution(found, format_distribution_title(inspection), folder / "distribution.png"))
        paths.append(write_distribution(found, folder / "distribution.csv"))
    elevations = []
    if wanted.facades:
        (folder / "elevations").mkdir(parents=True, exist_ok=True)
        elevations = draw_elevations(inspection, surface, folder / "elevations", settings, wanted.facades)
        paths += [elevation.path for elevation in elevations]
        gone |= {name for name in inspection.posed if not inspection.locate_photograph(name).is_file()}
    if wanted.defect_ids:
        places = map_defects_to_elevations(elevations)
        others = [name for name in wanted.defect_ids if name not in places]
        if others:
            facades = find_drawn_facades(inspection, surface, settings)
            places |= map_defects_to_model(inspection, surface, facades, others)
        cards = draw_cards(
            inspection, surface, wanted.defect_ids, folder / "cards", places=places,
            most_sightings=settings.card_observations,
        )  # fmt: skip
        paths += [cards.paths[name] for name in wanted.defect_ids]
        gone |= set(cards.missing)
    if wanted.photo_ids:
        (folder / "overlays").mkdir(parents=True, exist_ok=True)
        overlays = draw_overlays(inspection, surface, wanted.photo_ids, folder / "overlays", settings)
        paths += overlays.values()
        gone |= set(wanted.photo_ids) - overlays.keys()
    return DrawnPictures(paths=tuple(dict.fromkeys(paths)), missing=tuple(sorted(gone)))


def _invert_unique(short: Mapping[str, str]) -> dict[str, str]:
    """Full names by short ones, those short ones alone that are of one name."""
    every = list(short.values())
    return {word: name for name, word in short.items() if every.count(word) == 1}


def _index_facade_names(sheets: Sequence[str]) -> dict[str, str]:
    """Facades by their letters too: "SE" is "South-east"."""
    letters = {name: "".join(part[0] for part in name.partition(" ")[0].split("-")).upper() for name in sheets}
    return _invert_unique(letters) | {name.replace(" ", "_"): name for name in sheets}


def _match_name(word: str, what: str, names: Sequence[str], short: Mapping[str, str]) -> str:
    """The name that ``word`` stands for, capitals or not."""
    if word in names:
        return word
    exact = {other.lower(): name for other, name in (*short.items(), *((name, name) for name in names))}
    if word.lower() in exact:
        return exact[word.lower()]
    near = get_close_matches(word.lower(), list(exact), n=4, cutoff=0.5)
    told = list(dict.fromkeys(exact[one] for one in near)) or list(names[:4])
    if not told:
        raise InputDataError(f"there is no {what} '{word}'; the campaign has none")
    more = "" if near else f" (of {len(names)})"
    raise InputDataError(f"there is no {what} '{word}' in this campaign; near it: {', '.join(told)}{more}")


_TABLES = (
    "photos", "poses", "georeference", "georeference_points", "detections", "observations", "defects", "merges",
    "integrity_views", "checks",
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
    all_of_them: bool = False,
) -> DrawnPictures:
    """Pictures of a committed campaign into ``folder``; of what the report shows where nothing is named.

    Tables come from the lake, photographs and the building's model from the registry. Raises StoreError where the
    lake does not hold the campaign, InputDataError for a name there is not or a model that is not the campaign's.
    """
    inspection = _read_inspection(building, campaign_id, lake)
    surface = Surface(inspection.building)
    settings = PictureSettings()
    if all_of_them:
        wanted = select_all(inspection, surface, settings)
    elif defects or facades or photos:
        wanted = select_by_name(inspection, surface, defects=defects, facades=facades, photos=photos, settings=settings)
    else:
        wanted = select_report_pictures(inspection, surface, settings)
    return draw_selection(inspection, surface, wanted, folder, settings)


def _read_inspection(building: Building, campaign_id: str, lake: Path) -> Inspection:
    held = read_committed_tables(building, campaign_id, _TABLES, lake=lake)
    tables = {name: held[name].select(get_stage_schema(name).names) for name in _TABLES}
    return Inspection(
        building_name=building.name,
        campaign_id=campaign_id,
        photographs_root=building.locate_photographs(campaign_id),
        building=read_committed_model(building, campaign_id, held["buildings"].to_pylist()[0]),
        posed=read_posed_cameras(tables["poses"]),
        placement_sigma_max_m=building.tolerances.placement_sigma_max_m,
        **tables,
    )
