"""Notes on the pictures of a regraded release, which were drawn with the grades of an earlier version of the lake."""

from __future__ import annotations

from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

REPORT = "report.html"
CARDS = "cards"
_NOTE_ID = 'id="drawn-for-another-version"'
_CARD_KEY = "Older grades"  # text in the PNG of a card that has its note
_STRIP_PX, _TEXT_PX = 48, 26


def mark_older_grades(folder: Path, version: int) -> None:
    """Add a note to report and cards in ``folder`` that their grades are of ``version``, unless they have one."""
    _mark_report(folder / REPORT, version)
    for card in sorted((folder / CARDS).glob("*.png")):
        _mark_card(card, version)


def _mark_report(report: Path, version: int) -> None:
    if not report.is_file():
        return
    text = report.read_text("utf-8")
    if _NOTE_ID in text:
        return
    note = (
        f"<p {_NOTE_ID}><b>This report shows version {version} of the lake. The defects were regraded since; "
        "the current grades are in the tables of this release.</b></p>"
    )
    report.chmod(0o644)  # copied from a read-only release
    report.write_text(text.replace("</h1>", f"</h1>{note}", 1), encoding="utf-8")


def _mark_card(card: Path, version: int) -> None:
    """Put a strip with the note on top of a card: cards are sent and printed alone, without the report."""
    with Image.open(card) as opened:
        if _CARD_KEY in opened.info:
            return
        drawn = opened.convert("RGB")
    note = f"Grades of version {version} of the lake. Regraded since: the current grades are in the tables."
    marked = Image.new("RGB", (drawn.width, drawn.height + _STRIP_PX), "#fff3c4")
    marked.paste(drawn, (0, _STRIP_PX))
    ImageDraw.Draw(marked).text(
        (_STRIP_PX / 2, _STRIP_PX / 2),
        note,
        fill="black",
        font=ImageFont.load_default(_TEXT_PX),
        anchor="lm",
    )
    text = PngInfo()
    text.add_text(_CARD_KEY, note)
    card.chmod(0o644)
    marked.save(card, pnginfo=text, compress_level=1)
