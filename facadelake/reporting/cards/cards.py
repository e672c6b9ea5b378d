"""The cards of many defects: each photograph is read once, a card is drawn when the last of its photographs was."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import UInt8Array, UInt8Image
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.reporting.cards.crops import crop_detection, format_file_label
from facadelake.reporting.cards.facts import Row, group_merges, list_card_facts
from facadelake.reporting.cards.figure import BEST_PX, DPI, TILE_PX, CardContents, ObservationTile, draw_card
from facadelake.reporting.cards.observations import DefectObservation, group_observations
from facadelake.reporting.cards.patch_view import PatchView, choose_patch_side_m, rectify_patch
from facadelake.reporting.drawing.palette import get_class_colour
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.elevations.marks import DefectMark, create_marks
from facadelake.reporting.elevations.overview import FacadeOverview
from facadelake.reporting.elevations.storeys import find_storey_bases
from facadelake.reporting.inspection import Inspection

log = logging.getLogger(__name__)

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 93]
_LEAST_CELLS, _MOST_CELLS = 120, 400


@dataclass(frozen=True, kw_only=True)
class CardFiles:
    """Files of the cards by defect_id, and the photographs that are missing or cannot be read."""

    paths: Mapping[str, Path]
    missing: tuple[str, ...]


@dataclass(kw_only=True, eq=False)
class _PendingCard:
    """A card whose photographs are being read; pieces are kept as JPEG: a campaign may have thousands of them."""

    mark: DefectMark
    row: Row
    observations: Sequence[DefectObservation]
    left_out: int
    best: DefectObservation | None
    unread_photos: set[str]
    tiles: dict[str, UInt8Array] = field(default_factory=dict)
    best_tile: UInt8Array | None = None
    patch: PatchView | None = None


def draw_cards(
    inspection: Inspection,
    surface: Surface,
    defect_ids: Iterable[str],
    folder: Path,
    *,
    overviews: Mapping[str, FacadeOverview],
    max_observations: int,
) -> CardFiles:
    """Write ``card_<label>.png`` into ``folder`` for each of ``defect_ids``.

    ``places`` are the facades that defects lie on, by defect_id; ``max_observations`` bounds what is drawn, and so what
    is read, for each. Memory: one photograph, and the pieces of those cards that wait for another one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    opened = _prepare_cards(inspection, frozenset(defect_ids), max_observations)
    wanted = sorted({photo_id for card in opened for photo_id in card.unread_photos})
    merges = group_merges(inspection.merges)
    storeys = find_storey_bases(inspection.building)
    paths: dict[str, Path] = {}
    missing: list[str] = []

    def finish(card: _PendingCard) -> None:
        path = folder / f"card_{format_file_label(card.mark.label)}.png"
        material = CardContents(
            mark=card.mark,
            subtitle=f"{inspection.building_name} · campaign {inspection.campaign_id}",
            facts=list_card_facts(card.row, inspection, merges.get(card.mark.defect_id, [])),
            best=_decode_jpeg(card.best_tile),
            best_photo_id=card.best.photo_id if card.best else None,
            patch=card.patch,
            tiles=[
                ObservationTile(observation=one, picture=_decode_jpeg(card.tiles.get(one.detection_id)))
                for one in card.observations
            ],
            left_out=card.left_out,
            overview=overviews.get(card.mark.defect_id),
            storeys=storeys,
        )
        draw_card(material).savefig(path, dpi=DPI, pil_kwargs={"compress_level": 1})
        paths[card.mark.defect_id] = path

    for card in opened:
        if not card.unread_photos:
            finish(card)
    for photo_id in track(wanted, label="Drawing cards"):
        cards = [card for card in opened if photo_id in card.unread_photos]
        try:
            pixels = read_photograph(inspection.locate_photograph(photo_id), inspection.posed[photo_id].camera)
        except InputDataError as error:
            log.warning("its defects' cards do without it: %s", error)
            missing.append(photo_id)
            pixels = None
        for card in cards:
            if pixels is not None:
                _add_photograph(card, photo_id, pixels, inspection, surface)
            card.unread_photos.remove(photo_id)
            if not card.unread_photos:
                finish(card)
        opened = [card for card in opened if card.unread_photos]
    return CardFiles(paths=paths, missing=tuple(missing))


def _prepare_cards(inspection: Inspection, defect_ids: frozenset[str], max_observations: int) -> list[_PendingCard]:
    rows = {row["defect_id"]: row for row in inspection.defects.to_pylist()}
    sightings = group_observations(inspection)
    opened = []
    for mark in create_marks(inspection.defects, inspection.building.origin):
        if mark.defect_id not in defect_ids:
            continue
        own = [one for one in sightings[mark.defect_id] if one.photo_id in inspection.posed]
        shown = own[:max_observations]
        there = [one for one in shown if inspection.locate_photograph(one.photo_id).is_file()]
        opened.append(
            _PendingCard(
                mark=mark,
                row=rows[mark.defect_id],
                observations=shown,
                left_out=len(own) - len(shown),
                best=there[0] if there else None,
                unread_photos={one.photo_id for one in shown},
            )
        )
    return opened


def _add_photograph(
    card: _PendingCard, photo_id: str, pixels: UInt8Image, inspection: Inspection, surface: Surface
) -> None:
    """Cut out of a photograph (RGB) what the card shows of it."""
    colour = get_class_colour(card.mark.defect_class)
    for sighting in card.observations:
        if sighting.photo_id == photo_id:
            card.tiles[sighting.detection_id] = _encode_jpeg(crop_detection(pixels, sighting.outline, TILE_PX, colour))
    if card.best is not None and card.best.photo_id == photo_id:
        card.best_tile = _encode_jpeg(crop_detection(pixels, card.best.outline, BEST_PX, colour))
        pixel_m = card.best.pixel_mm / 1000
        posed = inspection.posed[photo_id]
        # Cells of less than half a pixel show nothing more.
        cells = int(np.clip(2.0 * choose_patch_side_m(card.mark) / pixel_m, _LEAST_CELLS, _MOST_CELLS))
        card.patch = rectify_patch(card.mark, posed, pixels, surface, cells, pixel_m)


def _encode_jpeg(bgr: UInt8Image) -> UInt8Array:
    return np.asarray(cv2.imencode(".jpg", bgr, _QUALITY)[1], dtype=np.uint8)


def _decode_jpeg(piece: UInt8Array | None) -> UInt8Image | None:
    """RGB pixels of a kept piece."""
    if piece is None:
        return None
    bgr = cv2.imdecode(piece, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(np.asarray(bgr), cv2.COLOR_BGR2RGB), dtype=np.uint8)
