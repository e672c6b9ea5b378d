"""Options that commands share (portfolio, lake, building, campaign), and the consoles they print to."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import InputDataError

if TYPE_CHECKING:
    from facadelake.registry import Portfolio, ServiceSettings

# Where the output goes to a file or a pipe there is no width to keep to.
console = Console(width=None if sys.stdout.isatty() else 160)
problems = Console(stderr=True)

PortfolioPath = Annotated[
    Path,
    typer.Option("--portfolio", envvar="FACADELAKE_PORTFOLIO", help="Portfolio: a YAML file, or a folder of them."),
]
LakePath = Annotated[
    Path, typer.Option("--lake", envvar="FACADELAKE_LAKE", help="Folder of the lake; created if it does not exist.")
]
ExistingLakePath = Annotated[Path, typer.Option("--lake", envvar="FACADELAKE_LAKE", help="Folder of the lake.")]
AnyPortfolioPath = Annotated[
    Path, typer.Option("--portfolio", help="Accepted as by every command; a query of the lake needs no portfolio.")
]
SettingsPath = Annotated[
    Path,
    typer.Option(
        "--settings",
        envvar="FACADELAKE_SETTINGS",
        help="Settings of the service: portfolio, lake, database, port, limits (docs/service.md). Every key has a "
        "default, and so has the file.",
    ),
]
OtherPortfolioPath = Annotated[
    Path | None, typer.Option("--portfolio", envvar="FACADELAKE_PORTFOLIO", help="Another portfolio than theirs.")
]
OtherLakePath = Annotated[
    Path | None, typer.Option("--lake", envvar="FACADELAKE_LAKE", help="Another lake than that of the settings.")
]
BuildingId = Annotated[str, typer.Argument(help="Id of the building in the portfolio.")]
AsOf = Annotated[
    str | None,
    typer.Option(
        metavar="VERSION|TIME",
        help="Read an earlier version of the lake: its number, or the last one committed at or before a time: "
        "2026-04-30 (its end), 2026-04-30T14:30, 2026-04-30T14:30+02:00; UTC where no offset is given.",
    ),
]
CampaignId = Annotated[
    str, typer.Argument(help="Id of the campaign, such as 2026-04; 'latest' is the newest by capture time.")
]
DEFAULT_PORTFOLIO = CHECKOUT / "data" / "portfolio.yaml"
DEFAULT_LAKE = CHECKOUT / "lake"
DEFAULT_SETTINGS = CHECKOUT / "facadelake.yaml"


def require_lake(lake: Path) -> None:
    """Raise InputDataError where the folder holds no lake."""
    from facadelake.lake import has_lake

    if not has_lake(lake):
        raise InputDataError(
            f"there is no lake in {lake}; inspect a campaign first, or name another with --lake or FACADELAKE_LAKE"
        )


def require_output_folder(folder: Path | None, option: str) -> None:
    """Raise InputDataError where files cannot be written into ``folder``, so that a command ends before its work.

    Args:
        folder: the folder, which need not exist; None: none was given.
        option: the option that named it.
    """
    if folder is None:
        return
    there = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
    if not there.is_dir():
        named = "is a file" if there == folder.absolute() else f"cannot be created, since {there} is a file"
        raise InputDataError(
            f"{option} {folder} {named}, but several files are written into a folder: name another one, or move the "
            "file away"
        )
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputDataError(
            f"{option} {folder} cannot be written: {there} may not be changed by this user; name another folder, or "
            "change its rights"
        )


def read_portfolio_at(path: Path) -> Portfolio:
    """The portfolio at ``path``."""
    from facadelake.registry import read_portfolio

    return read_portfolio(path)


def read_settings_at(path: Path, portfolio: Path | None = None, lake: Path | None = None) -> ServiceSettings:
    """The service's settings at ``path``; ``portfolio`` and ``lake`` in place of theirs, where they are given."""
    from facadelake.registry import read_service_settings

    others = {"portfolio": portfolio, "lake": lake}
    given = {key: str(value.resolve()) for key, value in others.items() if value is not None}
    return read_service_settings(path).model_copy(update=given)
