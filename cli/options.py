"""What every command takes: where registry and lake are, which building and campaign; where answers are printed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from facadelake.core.checkout import CHECKOUT

if TYPE_CHECKING:
    from facadelake.registry import Portfolio

# Where the output goes to a file or a pipe there is no width to keep to.
console = Console(width=None if sys.stdout.isatty() else 160)
problems = Console(stderr=True)

PortfolioPath = Annotated[
    Path,
    typer.Option("--portfolio", envvar="FACADELAKE_PORTFOLIO", help="Registry: a YAML file, or a folder of them."),
]
LakePath = Annotated[
    Path, typer.Option("--lake", envvar="FACADELAKE_LAKE", help="Folder of the lake; made if it is not there.")
]
AnyPortfolioPath = Annotated[
    Path, typer.Option("--portfolio", help="Taken as by every command; a question to the lake needs no registry.")
]
BuildingId = Annotated[str, typer.Argument(help="Id of the building in the registry.")]
CampaignId = Annotated[str, typer.Argument(help="Id of the campaign, such as 2026-04; 'latest' for the newest.")]
DEFAULT_PORTFOLIO = CHECKOUT / "data" / "portfolio.yaml"
DEFAULT_LAKE = CHECKOUT / "lake"


def portfolio_at(path: Path) -> Portfolio:
    """The registry at ``path``."""
    from facadelake.registry import read_portfolio

    return read_portfolio(path)
