"""A pair of pictures in a page: one above the other with a slider between them, and beside it their difference.

The slider is an input of type range, so that keys move it; without scripts both pictures stand side by side.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

from facadelake.reporting.history.pairs import Pair
from facadelake.reporting.html import Html, html_from_value, link_file

PAIR_STYLE = (
    ".pair { display: flex; flex-wrap: wrap; gap: 0.4rem 1rem; margin: 0.5rem 0; align-items: flex-start; }"
    " .pair > * { width: min(100%, 380px); } .pair .view { font-size: 0.85rem; }"
    " .pair .notes { color: var(--soft); font-size: 0.85rem; } .pair .notes.alone { width: auto; }"
    " .pair .stage { position: relative; aspect-ratio: 1; --cut: 50%; }"
    " .pair .stage img, .pair .stage svg { position: absolute; inset: 0; width: 100%; height: 100%; border: 0; }"
    " .pair .stage .over { clip-path: inset(0 calc(100% - var(--cut)) 0 0); }"
    " .pair .stage .cut { position: absolute; top: 0; bottom: 0; left: var(--cut); width: 2px; margin-left: -1px;"
    " background: #fff; box-shadow: 0 0 2px #000; }"
    # Black and white, so that it is seen on any wall.
    " .pair .outline polygon { fill: none; stroke: #000; stroke-width: 1.6; vector-effect: non-scaling-stroke; }"
    " .pair .outline polygon.dashes { stroke: #fff; stroke-dasharray: 4 4; }"
    " .pair input[type=range] { width: 100%; margin: 0.3rem 0 0; }"
    " .pair .ends { display: flex; justify-content: space-between; gap: 1rem; }"
    " .pair .ends span:last-child { text-align: right; }"
    " html:not(.scripted) .pair input { display: none; }"
    " html:not(.scripted) .pair .view.both { width: min(100%, 760px); }"
    " html:not(.scripted) .pair .both .stage { aspect-ratio: 2; }"
    " html:not(.scripted) .pair .both .stage img { width: 50%; }"
    " html:not(.scripted) .pair .both .stage .under { left: 50%; }"
    " html:not(.scripted) .pair .both .stage .over { clip-path: none; }"
    " html:not(.scripted) .pair .both .stage :is(.cut, .outline) { display: none; }"
    " @media print { .pair input { display: none; } .pair > * { width: 55mm; } .pair .view.both { width: 110mm; }"
    " .pair .both .stage { aspect-ratio: 2; } .pair .both .stage img { width: 50%; }"
    " .pair .both .stage .under { left: 50%; } .pair .both .stage .over { clip-path: none; }"
    " .pair .both .stage :is(.cut, .outline) { display: none !important; } }"
)
PAIR_SCRIPT = (
    'document.documentElement.classList.add("scripted");'
    'document.addEventListener("input", function (event) {'
    ' var view = event.target.closest(".pair .view"); if (!view || event.target.type !== "range") { return; }'
    ' view.querySelector(".stage").style.setProperty("--cut", event.target.value + "%"); });'
)


def render_pair(track_id: str, pair: Pair, names: tuple[str, str], folder: Path) -> Html:
    """The pictures of a track.

    Args:
        track_id: the track.
        pair: its pictures.
        names: the earlier and the later campaign.
        folder: folder of the page.
    """
    scale = f"{100 * pair.side_m:.0f} cm wide and high, cell {1000 * pair.cell_m:.1f} mm"
    notes = [html_from_value(text) for text in (*pair.remarks, scale if pair.before or pair.after else "") if text]
    views = [_render_both(track_id, pair, names, folder)] if pair.before or pair.after else []
    if pair.difference is not None:
        image = _render_image(pair.difference, folder, "", f"difference of {track_id}")
        views.append(
            f'<div class="view"><div class="stage">{image}{_render_outline(pair)}</div>difference without light: '
            "orange darker, blue lighter</div>"
        )
    kind = "notes" if views else "notes alone"
    return Html(f'<div class="pair">{"".join(views)}<div class="{kind}">{"<br>".join(notes)}</div></div>')


def _render_both(track_id: str, pair: Pair, names: tuple[str, str], folder: Path) -> str:
    earlier, later = names
    images = _render_image(pair.after, folder, "under", f"{track_id} in {later}")
    images += _render_image(pair.before, folder, "over" if pair.after else "", f"{track_id} in {earlier}")
    is_both = pair.before is not None and pair.after is not None
    label = escape(f"Share of {earlier} in the picture of {track_id}", quote=True)
    slider = f'<input type="range" min="0" max="100" value="50" aria-label="{label}">' if is_both else ""
    ends = "".join(
        f"<span>{html_from_value(name)}<br><small>{html_from_value(photo_id or 'no picture')}</small></span>"
        for name, photo_id in zip(names, pair.photo_ids, strict=True)
    )
    cut = '<span class="cut"></span>' if is_both else ""
    return (
        f'<div class="view{" both" if is_both else ""}"><div class="stage">{images}{cut}{_render_outline(pair)}</div>'
        f'{slider}<div class="ends">{ends}</div></div>'
    )


def _render_image(path: Path | None, folder: Path, kind: str, alternative: str) -> str:
    if path is None:
        return ""
    text = escape(alternative, quote=True)
    return f'<img class="{kind}" src="{link_file(path, folder)}" loading="lazy" alt="{text}">'


def _render_outline(pair: Pair) -> str:
    """The outline of the defect, in a picture of 100 by 100."""
    places = [
        " ".join(f"{50 + 100 * x / pair.side_m:.1f},{50 - 100 * y / pair.side_m:.1f}" for x, y in ring)
        for ring in pair.rings_m
    ]
    rings = "".join(f'<polygon points="{ring}"/><polygon class="dashes" points="{ring}"/>' for ring in places)
    return f'<svg class="outline" viewBox="0 0 100 100" aria-hidden="true">{rings}</svg>'
