"""Elements of an HTML page: text is escaped, no external resources, styles for light, dark and print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from urllib.parse import quote

from facadelake.reporting.drawing.palette import get_class_colour

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --soft: #5a5a5a; --ground: #ffffff; --line: #d5d5d5; --band: #f4f4f2;
  --good: #00664a; --check: #8a5a00; --bad: #a32d00; }
@media (prefers-color-scheme: dark) { :root { --ink: #ececec; --soft: #a9a9a9; --ground: #17181a; --line: #3c3d40;
  --band: #212225; --good: #4fd1a5; --check: #e8b84a;
  --bad: #ff9466; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1240px; padding: 1.2rem 1.4rem 3rem; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", Arial, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.7rem; margin: 0.4rem 0 0; } h2 { font-size: 1.2rem; margin: 2.2rem 0 0.6rem; }
p.under { color: var(--soft); margin: 0.1rem 0 0; }
nav { display: flex; flex-wrap: wrap; gap: 0.2rem 1.1rem; margin: 0.8rem 0; } a { color: inherit; }
.tiles { display: flex; flex-wrap: wrap; gap: 0.7rem; margin: 1rem 0; }
.tile { border: 1px solid var(--line); border-radius: 6px; padding: 0.5rem 0.9rem; min-width: 8.5rem;
  background: var(--band); }
.tile b { display: block; font-size: 1.45rem; line-height: 1.25; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: 0.85rem; }
.side { display: flex; flex-wrap: wrap; gap: 1rem 2.2rem; align-items: flex-start; }
.side > div { min-width: 0; max-width: 100%; }
.scroll { overflow-x: auto; overflow-wrap: normal; }
table { border-collapse: collapse; font-size: 0.9rem; margin: 0.3rem 0; }
caption { text-align: left; font-weight: 600; padding: 0.2rem 0; }
th, td { padding: 0.22rem 0.65rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: middle; }
th { background: var(--band); white-space: nowrap; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 0.6rem 0 1.6rem; }
figure img { max-width: 100%; height: auto; border: 1px solid var(--line); background: #ffffff; }
figcaption { color: var(--soft); font-size: 0.85rem; }
img.crop { width: 110px; height: 110px; display: block; border-radius: 3px; }
.dot { display: inline-block; width: 0.75em; height: 0.75em; border-radius: 50%; margin-right: 0.4em;
  border: 1px solid #8884; }
.good { color: var(--good); } .check { color: var(--check); font-weight: 600; }
.bad { color: var(--bad); font-weight: 600; }
.soft { color: var(--soft); }
code { font-size: 0.9em; } pre { white-space: pre-wrap; }
@media print {
  :root { --ink: #000; --soft: #444; --ground: #fff; --line: #bbb; --band: #f2f2f2; --good: #00664a;
    --check: #8a5a00; --bad: #a32d00; }
  @page { size: A4; margin: 12mm 10mm; }
  body { max-width: none; padding: 0; font-size: 8.5pt; line-height: 1.3; } nav { display: none; }
  h2 { break-after: avoid; margin: 4mm 0 2mm; }
  figure, tr, .tile { break-inside: avoid; } figure { margin: 1mm 0 3mm; }
  figure img { max-height: 112mm; } .scroll { overflow: visible; } .side { gap: 2mm 6mm; }
  th, td { padding: 0.4mm 1.2mm; } th { white-space: normal; } thead { display: table-header-group; }
  img.crop { width: 12mm; height: 12mm; }
  .tile { min-width: 0; padding: 1mm 2mm; } .tile b { font-size: 1.1rem; } }
@media (max-width: 600px) { body { padding: 0.6rem 0.7rem 2rem; } }
"""


@dataclass(frozen=True)
class Html:
    """Text that is HTML already; all other text is escaped."""

    text: str


def html_from_value(value: object) -> str:
    """The content of a cell or paragraph as HTML; None becomes a dash."""
    if isinstance(value, Html):
        return value.text
    return "–" if value is None else escape(str(value))


def render_page(title: str, body: Iterable[Html], *, style: str = "") -> str:
    """An HTML document without references outside its folder; ``style``: CSS beside that of all pages."""
    content = "\n".join(element.text for element in body)
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}{style}</style>\n</head>\n<body>\n{content}\n</body>\n</html>\n"
    )


def render_table(
    heads: Sequence[str], rows: Iterable[Sequence[object]], *, caption: str = "", numeric: Iterable[int] = ()
) -> Html:
    """A table.

    Args:
        heads: column heads.
        rows: cells, one per column; None becomes a dash.
        caption: caption above the table.
        numeric: indices of columns that are aligned right.
    """
    right_aligned = frozenset(numeric)
    kind = [' class="n"' if i in right_aligned else "" for i in range(len(heads))]
    head = "".join(f"<th{k}>{html_from_value(h)}</th>" for h, k in zip(heads, kind, strict=True))
    lines = [
        "<tr>" + "".join(f"<td{k}>{html_from_value(cell)}</td>" for cell, k in zip(row, kind, strict=True)) + "</tr>"
        for row in rows
    ]
    if not lines:
        lines = [f'<tr><td colspan="{len(heads)}" class="soft">none</td></tr>']
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    top = f"<thead><tr>{head}</tr></thead>" if any(heads) else ""
    return Html(f'<div class="scroll"><table>{title}{top}<tbody>\n' + "\n".join(lines) + "\n</tbody></table></div>")


def render_figure(path: Path, folder: Path, alternative: str, caption: str) -> Html:
    """A picture at the width of the page, linked at full size.

    Args:
        path: file of the picture, below ``folder``.
        folder: folder of the page.
        alternative: alternative text.
        caption: caption below the picture.
    """
    link = link_file(path, folder)
    return Html(
        f'<figure><a href="{link}"><img src="{link}" alt="{escape(alternative, quote=True)}"></a>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def link_file(path: Path, folder: Path) -> str:
    """URL of a file relative to the page's folder, quoted and escaped for an attribute."""
    return escape(quote(path.relative_to(folder).as_posix()), quote=True)


def render_tiles(values: Iterable[tuple[object, str]]) -> Html:
    """Key figures side by side: (value, name)."""
    return Html(
        '<div class="tiles">'
        + "".join(
            f'<div class="tile"><b>{html_from_value(v)}</b><span>{escape(name)}</span></div>' for v, name in values
        )
        + "</div>"
    )


def render_row(elements: Iterable[Html]) -> Html:
    """Elements side by side, wrapped where the page is narrow."""
    return Html('<div class="side">' + "".join(f"<div>{element.text}</div>" for element in elements) + "</div>")


def render_section(name: str, title: str, *elements: Html) -> Html:
    """A section with a heading; ``name`` is its anchor."""
    content = "\n".join(element.text for element in elements)
    return Html(f'<section id="{escape(name, quote=True)}"><h2>{escape(title)}</h2>\n{content}</section>')


def render_paragraph(text: object, kind: str = "") -> Html:
    """A paragraph of CSS class ``kind``."""
    return Html(
        f'<p class="{escape(kind, quote=True)}">{html_from_value(text)}</p>'
        if kind
        else f"<p>{html_from_value(text)}</p>"
    )


def html_from_class(defect_class: str) -> Html:
    """The name of a defect class with its colour."""
    return Html(
        f'<span class="dot" style="background:{get_class_colour(defect_class)}"></span>{html_from_value(defect_class)}'
    )
