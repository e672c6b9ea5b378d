"""Commands on the history of a building: two campaigns compared, one track explained. The lake is not changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import (
    DEFAULT_LAKE,
    DEFAULT_PORTFOLIO,
    AsOf,
    BuildingId,
    ExistingLakePath,
    PortfolioPath,
    console,
    read_portfolio_at,
    require_output_folder,
)
from facadelake.core.errors import InputDataError

if TYPE_CHECKING:
    from facadelake.registry import Building


def compare(
    building: BuildingId,
    earlier: Annotated[
        str | None, typer.Argument(metavar="FROM", help="The earlier campaign; left out, the one before TO.")
    ] = None,
    later: Annotated[
        str | None, typer.Argument(metavar="TO", help="The later campaign; left out, the latest by capture time.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of listed defects in the terminal.")] = 40,
    pairs: Annotated[
        int | None, typer.Option(min=0, help="Maximum number of defects with pictures on the page; default: 150.")
    ] = None,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Whether to write the page with pictures.")] = True,
    output: Annotated[
        Path | None, typer.Option(help="Folder of the page; default: one in the lake's 'comparisons'.")
    ] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Compare two campaigns: which defects are new, reopened, grown, of another class or severity, repaired, missed,
    or not looked at.

    What is said is the later campaign against the earlier one, whatever lies between. The table lists what needs
    attention, the most urgent first; unchanged defects are counted. The page shows the states on each elevation, and
    every listed defect before and after with a slider; it needs no network.
    """
    from cli.terminal.drawing import run_with_progress
    from cli.terminal.history import show_comparison
    from cli.terminal.listings import require_known
    from facadelake.lake import resolve_version
    from facadelake.reporting.history import PAIRS_MAX, compare_committed, locate_comparison, write_comparison

    require_known(lake, portfolio, building)
    if page:
        require_output_folder(output or lake / "comparisons", "--output" if output else "folder of the page:")
    version = resolve_version(lake, as_of)
    comparison, tables = compare_committed(lake, building, earlier, later, as_of=version)
    show_comparison(console, comparison, limit)
    if not page:
        return
    folder = output or locate_comparison(lake, building, comparison.earlier, comparison.later, version)
    registered = _find_registered(portfolio, building)
    path = run_with_progress(
        console,
        lambda: write_comparison(
            comparison, tables, registered, folder, pairs_max=PAIRS_MAX if pairs is None else pairs
        ),
    )
    console.print(f"page {path}", soft_wrap=True, highlight=False, markup=False)


def why(
    track: Annotated[str, typer.Argument(help="Id of the track, such as castle-0042.")],
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder for the pictures of its place before and after, with their difference."),
    ] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Explain a track: its state in each campaign, which defects were candidates and why one was taken, what the
    photographs of its place show, and what persons said of it."""
    from cli.terminal.drawing import run_with_progress
    from cli.terminal.history import show_explanation, show_track_pictures
    from facadelake.lake import resolve_version
    from facadelake.reporting.history import draw_track, explain_track

    require_output_folder(pictures, "--pictures")
    version = resolve_version(lake, as_of)
    explained = explain_track(lake, track, as_of=version)
    show_explanation(console, explained)
    if pictures is not None:
        building = _find_registered(portfolio, explained.building_id)
        drawn = run_with_progress(console, lambda: draw_track(track, building, lake, pictures, as_of=version))
        show_track_pictures(console, drawn)


def _find_registered(portfolio: Path, building_id: str) -> Building | None:
    """The building in the portfolio; None where it is no longer registered, which the pictures say."""
    try:
        return read_portfolio_at(portfolio).get_building(building_id)
    except InputDataError:
        return None
