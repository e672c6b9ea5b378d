"""The symbols of findings in a page: SVG that is defined once, its styles, and the strip of a track's campaigns."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from facadelake.reporting.history.compared_track import ComparedTrack, TimelineEntry
from facadelake.reporting.history.findings import STYLES, Finding
from facadelake.reporting.history.size_changes import format_size
from facadelake.reporting.html import Html, html_from_class, html_from_value

SYMBOL_STYLE = (
    ".open { fill: none; stroke-width: var(--rim, 3); } .line { fill: none; stroke-width: var(--rim, 3.4); }"
    " .halo { --rim: 7; fill: #fff; stroke: #fff; stroke-width: 4; stroke-linejoin: round; }"
    " svg.symbol { width: 1.25em; height: 1.25em; vertical-align: -0.25em; overflow: visible; }"
    # A symbol takes the colour of the nearest finding: a timeline has those of several states within one track.
    " .ink { fill: var(--mark); stroke: var(--mark); } .one-line { white-space: nowrap; }"
    " svg.symbol .halo { opacity: 0.9; }"
    + "".join(f" .f-{finding.name.lower()} {{ --mark: {style.colour}; }}" for finding, style in STYLES.items())
)


def render_definitions() -> Html:
    """The symbols, to be placed once in a page."""
    symbols = "".join(f'<g id="mark-{f.name.lower()}">{style.shape}</g>' for f, style in STYLES.items())
    return Html(f'<svg width="0" height="0" style="position:absolute" aria-hidden="true"><defs>{symbols}</defs></svg>')


def render_mark(finding: Finding) -> str:
    """The symbol with a white rim, in a square of -10 to 10 of an SVG."""
    name = finding.name.lower()
    return f'<use href="#mark-{name}" class="halo"/><use href="#mark-{name}" class="ink"/>'


def render_symbol(finding: Finding) -> Html:
    """The symbol in a line of text; its name is to stand beside it."""
    name = finding.name.lower()
    return Html(f'<svg class="symbol f-{name}" viewBox="-12 -12 24 24" aria-hidden="true">{render_mark(finding)}</svg>')


def render_named_symbol(finding: Finding) -> Html:
    """The symbol and the name of a finding."""
    return Html(f'<span class="one-line">{render_symbol(finding).text} {html_from_value(finding)}</span>')


def render_class(track: ComparedTrack) -> Html:
    """The class of a defect with its colour, and the one before where it was another."""
    names = [track.defect_class]
    if track.before is not None and track.before["defect_class"] != track.defect_class:
        names.insert(0, track.before["defect_class"])
    return Html(" → ".join(f'<span class="one-line">{html_from_class(name).text}</span>' for name in names))


def render_timeline(entries: Sequence[TimelineEntry], pair: Sequence[str]) -> Html:
    """A strip of all campaigns with state and size; the campaigns of ``pair`` are emphasised."""
    items = []
    for entry in entries:
        if entry.state is None:
            symbol, word = '<span class="soft">·</span>', "not known yet"
        else:
            finding = entry.state.finding
            symbol, word = render_symbol(finding).text, "seen" if finding is Finding.UNCHANGED else str(finding)
        size = format_size(entry.defect)
        chosen = ' class="chosen"' if entry.campaign_id in pair else ""
        items.append(
            f"<li{chosen}><b>{escape(entry.campaign_id)}</b><br>{symbol} {escape(word)}"
            f"<br><span class='soft'>{escape(size)}</span></li>"
        )
    return Html(f'<ol class="strip">{"".join(items)}</ol>')
