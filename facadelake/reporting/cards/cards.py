"""Cards of many defects. Each photograph is read once; a card is drawn after the last of its photographs."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import UInt8Array, UInt8Image
from facadelake.core.errors import InputDataError
from facadelake.core.progress import report_progress
from facadelake.reporting.cards.crops import crop_detection, format_file_label
from facadelake.reporting.cards.facts import Row, group_merges, list_card_facts
from facadelake.reporting.cards.figure import BEST_PX, TILE_PX, CardContents, ObservationTile, draw_card
from facadelake.reporting.cards.observations import DefectObservation, group_observations
from facadelake.reporting.cards.patch_view import PatchView, choose_patch_side_m, rectify_patch
from facadelake.reporting.drawing.palette import get_class_colour
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.drawing.png_writer import PngWriter
from facadelake.reporting.elevations.marks import DefectMark, create_marks
from facadelake.reporting.elevations.overview import FacadeOverview
from facadelake.reporting.elevations.storeys import find_storey_bases
from facadelake.reporting.inspection import Inspection

log = logging.getLogger(__name__)

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 93]
_MIN_CELLS, _MAX_CELLS = 120, 400


@dataclass(frozen=True, kw_only=True)
class CardFiles:
    """Files of the cards by defect_id, and photographs that are missing or unreadable."""

    paths: Mapping[str, Path]
    missing: tuple[str, ...]


@dataclass(kw_only=True, eq=False)
class _PendingCard:
    """A card whose photographs are being read; crops are kept as JPEG, because there may be thousands of them."""

    mark: DefectMark
    row: Row
    observations: Sequence[DefectObservation]
    left_out: int
    views: list[DefectObservation]
    unread_photos: set[str]
    unreadable: list[str] = field(default_factory=list)
    tiles: dict[str, UInt8Array] = field(default_factory=dict)
    best_tile: UInt8Array | None = None
    patch: PatchView | None = None

    @property
    def best(self) -> DefectObservation | None:
        """The best of its observations whose photographs were not found to be unreadable."""
        return self.views[0] if self.views else None

    def exclude_photograph(self, photo_id: str) -> str | None:
        """Leave out an unreadable photograph; returns the photograph that is the best one in its place, if it is."""
        was_best = self.best is not None and self.best.photo_id == photo_id
        self.views = [view for view in self.views if view.photo_id != photo_id]
        self.unreadable.append(photo_id)
        return self.best.photo_id if was_best and self.best is not None else None


def draw_cards(
    inspection: Inspection,
    surface: Surface,
    defect_ids: Iterable[str],
    folder: Path,
    *,
    overviews: Mapping[str, FacadeOverview],
    max_observations: int,
) -> CardFiles:
    """Write ``card_<label>.png`` for each defect.

    Memory: one photograph, and the crops of cards that need further photographs.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        defect_ids: defects.
        folder: folder to write into.
        overviews: overviews of the facades by defect_id; a defect without one is not on an elevation.
        max_observations: largest number of observations on a card, which limits the photographs to be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pending = _prepare_cards(inspection, frozenset(defect_ids), max_observations)
    queue = deque(sorted({photo_id for card in pending for photo_id in card.unread_photos}))
    merges = group_merges(inspection.merges)
    storeys = find_storey_bases(inspection.building)
    paths: dict[str, Path] = {}
    missing: list[str] = []

    def finish(card: _PendingCard, writer: PngWriter) -> None:
        path = folder / f"card_{format_file_label(card.mark.label)}.png"
        contents = CardContents(
            mark=card.mark,
            subtitle=f"{inspection.building_name} · campaign {inspection.campaign_id}",
            facts=list_card_facts(card.row, inspection, merges.get(card.mark.defect_id, [])),
            best=_decode_jpeg(card.best_tile),
            best_photo_id=card.best.photo_id if card.best else None,
            patch=card.patch,
            tiles=[
                ObservationTile(observation=item, picture=_decode_jpeg(card.tiles.get(item.detection_id)))
                for item in card.observations
            ],
            left_out=card.left_out,
            unreadable=card.unreadable,
            overview=overviews.get(card.mark.defect_id),
            storeys=storeys,
        )
        writer.write(draw_card(contents), path)
        paths[card.mark.defect_id] = path

    with PngWriter() as writer, report_progress("Drawing cards", len(queue)) as step:
        for card in pending:
            if not card.unread_photos:
                finish(card, writer)
        while queue:
            photo_id = queue.popleft()
            cards = [card for card in pending if photo_id in card.unread_photos]
            try:
                pixels = read_photograph(inspection.locate_photograph(photo_id), inspection.posed[photo_id].camera)
            except InputDataError as error:
                log.warning("photograph not shown on cards: %s", error)
                missing.append(photo_id)
                pixels = None
            for card in cards:
                card.unread_photos.remove(photo_id)
                if pixels is not None:
                    _add_photograph(card, photo_id, pixels, inspection, surface)
                elif (
                    next_best := card.exclude_photograph(photo_id)
                ) is not None and next_best not in card.unread_photos:
                    card.unread_photos.add(next_best)  # it was read before, but as one of the other views
                    queue.append(next_best)
                if not card.unread_photos:
                    finish(card, writer)
            pending = [card for card in pending if card.unread_photos]
            step.advance(1)
    return CardFiles(paths=paths, missing=tuple(missing))


def _prepare_cards(inspection: Inspection, defect_ids: frozenset[str], max_observations: int) -> list[_PendingCard]:
    rows = {row["defect_id"]: row for row in inspection.defects.to_pylist()}
    observations = group_observations(inspection)
    pending = []
    for mark in create_marks(inspection.defects, inspection.building.origin):
        if mark.defect_id not in defect_ids:
            continue
        localised = [item for item in observations[mark.defect_id] if item.photo_id in inspection.posed]
        selected = localised[:max_observations]
        pending.append(
            _PendingCard(
                mark=mark,
                row=rows[mark.defect_id],
                observations=selected,
                left_out=len(localised) - len(selected),
                views=localised,
                unread_photos={item.photo_id for item in selected},
            )
        )
    return pending


def _add_photograph(
    card: _PendingCard, photo_id: str, pixels: UInt8Image, inspection: Inspection, surface: Surface
) -> None:
    """Add the crops of a photograph (RGB) and, where it is the best one, the rectified view."""
    colour = get_class_colour(card.mark.defect_class)
    for observation in card.observations:
        if observation.photo_id == photo_id:
            crop = crop_detection(pixels, observation.outline, TILE_PX, colour)
            card.tiles[observation.detection_id] = _encode_jpeg(crop)
    if card.best is not None and card.best.photo_id == photo_id:
        card.best_tile = _encode_jpeg(crop_detection(pixels, card.best.outline, BEST_PX, colour))
        pixel_m = card.best.pixel_mm / 1000
        posed = inspection.posed[photo_id]
        # Cells smaller than half a pixel add no detail.
        cells = int(np.clip(2.0 * choose_patch_side_m(card.mark) / pixel_m, _MIN_CELLS, _MAX_CELLS))
        card.patch = rectify_patch(card.mark, posed, pixels, surface, cells, pixel_m)


def _encode_jpeg(bgr: UInt8Image) -> UInt8Array:
    return np.asarray(cv2.imencode(".jpg", bgr, _QUALITY)[1], dtype=np.uint8)


def _decode_jpeg(jpeg: UInt8Array | None) -> UInt8Image | None:
    """RGB pixels of an encoded crop."""
    if jpeg is None:
        return None
    bgr = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(np.asarray(bgr), cv2.COLOR_BGR2RGB), dtype=np.uint8)
