"""Commands of the service: start and stop it, see what it does, and make the deployments those of the registry."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table as RichTable

from cli.options import DEFAULT_SETTINGS, SettingsPath, console, read_portfolio_at, read_settings_at
from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import StoreError

if TYPE_CHECKING:
    from facadelake.registry import ServiceSettings
    from flows.deployments import DeploymentPlan

_LOG_LINES = 15


def up(
    foreground: Annotated[
        bool, typer.Option("--foreground", help="Stay in the terminal until Ctrl-C; for systemd and containers.")
    ] = False,
    json_logs: Annotated[bool, typer.Option("--json-logs", help="Log lines as JSON, for a log collector.")] = False,
    settings: SettingsPath = DEFAULT_SETTINGS,
) -> None:
    """Start the service: Prefect's server and its page, a worker, and the schedules of the portfolio.

    Both are started again when they end, and runs whose process is gone are closed. 'facadelake status' shows what
    goes on, 'facadelake down' stops it; 'facadelake systemd-unit' makes it start with the machine.
    """
    from cli.service.logs import log_to_stream
    from cli.service.supervisor import Supervisor, find_service

    read = _read(settings)
    lake = Path(read.lake)
    if foreground:
        log_to_stream(json_lines=json_logs)
        Supervisor(read, settings).run()
        return
    running = find_service(lake)
    if running is None:
        _start_in_background(read, settings, json_logs=json_logs)
    else:
        console.print(f"The service runs already (process {running.pid}).", highlight=False)
    _show_where(read)


def down(settings: SettingsPath = DEFAULT_SETTINGS) -> None:
    """Stop the service; runs that go on are ended within seconds and continue from the cache when started again."""
    from cli.service.supervisor import stop_service

    read = _read(settings)
    with console.status("Stopping the service"):
        stopped = stop_service(Path(read.lake))
    console.print("The service does not run." if stopped is None else f"Stopped (process {stopped}).", highlight=False)


def status(settings: SettingsPath = DEFAULT_SETTINGS) -> None:
    """Show whether the service runs, its workers, what runs now, what comes next, and what failed last.

    Exit status 1 where the service does not run, or its server or worker does not answer.
    """
    from cli.service.status import read_status, show_status

    found = read_status(_read(settings))
    show_status(console, found)
    if not found.is_well:
        raise typer.Exit(1)


def deploy(
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the difference and change nothing.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Apply without asking.")] = False,
    settings: SettingsPath = DEFAULT_SETTINGS,
) -> None:
    """Make the deployments on Prefect's server those of the portfolio; the difference is shown first.

    A deployment of a building that has left the portfolio is deleted. A schedule that somebody has switched off on
    Prefect's page stays off.
    """
    from cli.prefect_server import configure_prefect, find_running_server

    read = _read(settings)
    if find_running_server(Path(read.lake)) is None:
        raise StoreError(f"no Prefect server of the lake {read.lake} answers; start it with 'facadelake up'")
    configure_prefect(Path(read.lake))
    from prefect.client.orchestration import get_client

    from flows.deployments import apply_deployments, list_specs, plan_deployments

    specs = list_specs(read_portfolio_at(Path(read.portfolio)), read, str(settings.resolve()))
    with get_client(sync_client=True) as client:
        plan = plan_deployments(client, specs, read.lake)
        _show_plan(plan)
        if plan.is_empty or dry_run:
            return
        if not yes and not typer.confirm("Apply?"):
            raise typer.Exit(1)
        apply_deployments(client, plan, read)
    console.print("Applied.")


def systemd_unit(
    output: Annotated[
        Path | None, typer.Option(help="File to write, such as /etc/systemd/system/facadelake.service; else printed.")
    ] = None,
    user: Annotated[str | None, typer.Option(help="The user that it runs as; default: the one who asks.")] = None,
    settings: SettingsPath = DEFAULT_SETTINGS,
) -> None:
    """Write the unit with which systemd starts the service with the machine, and again when it ends."""
    from cli.service.systemd import format_unit

    _read(settings)
    text = format_unit(settings.resolve(), user)
    if output is None:
        sys.stdout.write(text)
        return
    output.write_text(text, encoding="utf-8")
    console.print(f"{output} is written; now: systemctl daemon-reload && systemctl enable --now {output.stem}")


def _read(settings: Path) -> ServiceSettings:
    """The settings, with a portfolio that can be read."""
    read = read_settings_at(settings)
    read_portfolio_at(Path(read.portfolio))
    return read


def _start_in_background(read: ServiceSettings, settings: Path, *, json_logs: bool) -> None:
    from cli.prefect_server import find_running_server, get_prefect_home
    from cli.service.supervisor import START_LIMIT_S

    home = get_prefect_home(Path(read.lake))
    home.mkdir(parents=True, exist_ok=True)
    path = home / "service.log"
    command = [sys.executable, "-c", "from cli.main import main; main()", "up", "--foreground"]
    command += ["--settings", str(settings.resolve()), *(["--json-logs"] if json_logs else [])]
    with path.open("ab") as output:
        start = output.tell()
        process = subprocess.Popen(
            command,
            cwd=CHECKOUT,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    deadline = time.monotonic() + START_LIMIT_S
    with console.status("Starting Prefect's server and a worker"):
        while find_running_server(Path(read.lake)) is None:
            if process.poll() is not None or time.monotonic() > deadline:
                with path.open("rb") as log:
                    log.seek(start)
                    said = log.read().decode(errors="replace").splitlines()[-_LOG_LINES:]
                raise StoreError("the service did not start; its log says:\n  " + "\n  ".join(said or [str(path)]))
            time.sleep(0.3)


def _show_where(read: ServiceSettings) -> None:
    home = Path(read.lake) / "prefect"
    console.print(f"Prefect's page  http://{read.host}:{read.port}", highlight=False)
    console.print(f"portfolio       {read.portfolio}", soft_wrap=True, highlight=False, markup=False)
    console.print(f"lake            {read.lake}", soft_wrap=True, highlight=False, markup=False)
    console.print(f"logs            {home}/service.log, server.log, worker.log", soft_wrap=True, highlight=False)
    console.print("see what goes on: facadelake status; stop: facadelake down", highlight=False)


def _show_plan(plan: DeploymentPlan) -> None:
    signs = {"create": "[green]+[/green]", "change": "[yellow]~[/yellow]", "delete": "[red]-[/red]", "keep": " "}
    table = RichTable(show_header=False, box=None, pad_edge=False)
    for change in plan.changes:
        if change.action == "keep":
            continue
        texts = [
            f"{name}: {before} -> {after}" if before else f"{name}: {after}" for name, before, after in change.fields
        ]
        table.add_row(signs[change.action], change.full_name, "; ".join(texts))
    console.print(table, highlight=False)
    counts = {action: sum(change.action == action for change in plan.changes) for action in signs}
    console.print(
        f"{counts['create']} to create, {counts['change']} to change, {counts['delete']} to delete, "
        f"{counts['keep']} as they are",
        highlight=False,
    )
