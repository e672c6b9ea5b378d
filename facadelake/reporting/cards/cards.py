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
from facadelake.reporting.cards.card import BEST_PX, DPI, TILE_PX, CardMaterial, SightingPiece, draw_card
from facadelake.reporting.cards.crops import cut_out, file_word
from facadelake.reporting.cards.facts import Row, card_facts, merges_by_defect
from facadelake.reporting.cards.patch_view import PatchView, patch_side_m, patch_view
from facadelake.reporting.cards.sightings import Sighting, sightings_of
from facadelake.reporting.drawing.palette import get_class_colour
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.elevations.backdrop import Backdrop
from facadelake.reporting.elevations.marks import Mark, marks_of
from facadelake.reporting.elevations.storeys import storey_levels
from facadelake.reporting.inspection import Inspection

log = logging.getLogger(__name__)

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 93]
_LEAST_CELLS, _MOST_CELLS = 120, 400


@dataclass(frozen=True, kw_only=True)
class Cards:
    """Files of the cards by defect_id, and the photographs that are missing or cannot be read."""

    paths: Mapping[str, Path]
    missing: tuple[str, ...]


@dataclass(kw_only=True, eq=False)
class _Open:
    """A card whose photographs are being read; pieces are kept as JPEG: a campaign may have thousands of them."""

    mark: Mark
    row: Row
    sightings: Sequence[Sighting]
    left_out: int
    best: Sighting | None
    to_come: set[str]
    pieces: dict[str, UInt8Array] = field(default_factory=dict)
    best_piece: UInt8Array | None = None
    patch: PatchView | None = None


def defect_cards(
    inspection: Inspection,
    surface: Surface,
    defect_ids: Iterable[str],
    folder: Path,
    *,
    places: Mapping[str, Backdrop],
    most_sightings: int,
) -> Cards:
    """Write ``card_<label>.png`` into ``folder`` for each of ``defect_ids``.

    ``places`` are the facades that defects lie on, by defect_id; ``most_sightings`` bounds what is drawn, and so what
    is read, for each. Memory: one photograph, and the pieces of those cards that wait for another one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    opened = _opened(inspection, frozenset(defect_ids), most_sightings)
    wanted = sorted({photo_id for card in opened for photo_id in card.to_come})
    merges = merges_by_defect(inspection.merges)
    storeys = storey_levels(inspection.building)
    paths: dict[str, Path] = {}
    missing: list[str] = []

    def finish(card: _Open) -> None:
        path = folder / f"card_{file_word(card.mark.label)}.png"
        material = CardMaterial(
            mark=card.mark,
            subtitle=f"{inspection.building_name} · campaign {inspection.campaign_id}",
            facts=card_facts(card.row, inspection, merges.get(card.mark.defect_id, [])),
            best=_unpacked(card.best_piece),
            best_photo_id=card.best.photo_id if card.best else None,
            patch=card.patch,
            pieces=[
                SightingPiece(sighting=one, picture=_unpacked(card.pieces.get(one.detection_id)))
                for one in card.sightings
            ],
            left_out=card.left_out,
            backdrop=places.get(card.mark.defect_id),
            storeys=storeys,
        )
        draw_card(material).savefig(path, dpi=DPI, pil_kwargs={"compress_level": 1})
        paths[card.mark.defect_id] = path

    for card in opened:
        if not card.to_come:
            finish(card)
    for photo_id in track(wanted, label="Drawing cards"):
        cards = [card for card in opened if photo_id in card.to_come]
        try:
            pixels = read_photograph(inspection.locate_photograph(photo_id), inspection.posed[photo_id].camera)
        except InputDataError as error:
            log.warning("its defects' cards do without it: %s", error)
            missing.append(photo_id)
            pixels = None
        for card in cards:
            if pixels is not None:
                _take(card, photo_id, pixels, inspection, surface)
            card.to_come.remove(photo_id)
            if not card.to_come:
                finish(card)
        opened = [card for card in opened if card.to_come]
    return Cards(paths=paths, missing=tuple(missing))


def _opened(inspection: Inspection, defect_ids: frozenset[str], most_sightings: int) -> list[_Open]:
    rows = {row["defect_id"]: row for row in inspection.defects.to_pylist()}
    sightings = sightings_of(inspection)
    opened = []
    for mark in marks_of(inspection.defects, inspection.building.origin):
        if mark.defect_id not in defect_ids:
            continue
        own = [one for one in sightings[mark.defect_id] if one.photo_id in inspection.posed]
        shown = own[:most_sightings]
        there = [one for one in shown if inspection.locate_photograph(one.photo_id).is_file()]
        opened.append(
            _Open(
                mark=mark,
                row=rows[mark.defect_id],
                sightings=shown,
                left_out=len(own) - len(shown),
                best=there[0] if there else None,
                to_come={one.photo_id for one in shown},
            )
        )
    return opened


def _take(card: _Open, photo_id: str, pixels: UInt8Image, inspection: Inspection, surface: Surface) -> None:
    """Cut out of a photograph (RGB) what the card shows of it."""
    colour = get_class_colour(card.mark.defect_class)
    for sighting in card.sightings:
        if sighting.photo_id == photo_id:
            card.pieces[sighting.detection_id] = _packed(cut_out(pixels, sighting.outline, TILE_PX, colour))
    if card.best is not None and card.best.photo_id == photo_id:
        card.best_piece = _packed(cut_out(pixels, card.best.outline, BEST_PX, colour))
        pixel_m = card.best.pixel_mm / 1000
        posed = inspection.posed[photo_id]
        # Cells of less than half a pixel show nothing more.
        cells = int(np.clip(2.0 * patch_side_m(card.mark) / pixel_m, _LEAST_CELLS, _MOST_CELLS))
        card.patch = patch_view(card.mark, posed, pixels, surface, cells, pixel_m)


def _packed(bgr: UInt8Image) -> UInt8Array:
    return np.asarray(cv2.imencode(".jpg", bgr, _QUALITY)[1], dtype=np.uint8)


def _unpacked(piece: UInt8Array | None) -> UInt8Image | None:
    """RGB pixels of a kept piece."""
    if piece is None:
        return None
    bgr = cv2.imdecode(piece, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(np.asarray(bgr), cv2.COLOR_BGR2RGB), dtype=np.uint8)
