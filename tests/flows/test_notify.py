"""Messages about the portfolio reach a web server, and one that cannot be sent is told."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from prefect.client.orchestration import SyncPrefectClient

from facadelake.core.errors import StoreError
from facadelake.registry import NotifySetting
from flows.campaign_runs import make_environment
from flows.inspect_portfolio import hold_portfolio
from tasks.portfolio.report import load_notification_block, notify
from tests.unit.scheduling.test_report import ALL, REPORT


class Receiver(BaseHTTPRequestHandler):
    """Keeps what is posted."""

    received: list[dict[str, str]]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.received.append(json.loads(body))
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[tuple[int, list[dict[str, str]]]]:
    """A port of this machine, and the messages that arrive there."""
    received: list[dict[str, str]] = []
    handler = type("Handler", (Receiver,), {"received": received})
    with HTTPServer(("127.0.0.1", 0), handler) as http:
        thread = threading.Thread(target=http.serve_forever)
        thread.start()
        yield http.server_port, received
        http.shutdown()
        thread.join()


def test_a_message_arrives_and_a_failure_to_send_is_told(server: tuple[int, list[dict[str, str]]]) -> None:
    port, received = server
    dead = "json://me:secret@127.0.0.1:9/token"
    problems = notify.fn(REPORT, NotifySetting(to=(dead, f"json://127.0.0.1:{port}/hook"), on=ALL), ())
    (message,) = received
    assert message["title"] == "Facadelake: 1 inspected, 1 failed, 2 overdue, 2 left out, 1 not done"
    assert "FAILED tower 2026-04: no control; bring control points" in message["message"]
    assert "OVERDUE new: by schedule since 2026-04-01; never inspected" in message["message"]
    (problem,) = problems
    assert problem.startswith("not told json://127.0.0.1:9/…: ") and "secret" not in problem


def test_nothing_is_sent_where_there_is_nothing_to_tell(server: tuple[int, list[dict[str, str]]]) -> None:
    port, received = server
    setting = NotifySetting(to=(f"json://127.0.0.1:{port}/hook",), on=("intake",))
    assert notify.fn(REPORT, setting, ()) == ()
    assert received == []


def test_an_address_of_no_service_is_told() -> None:
    (problem,) = notify.fn(REPORT, NotifySetting(to=("nonsense://host",), on=ALL), ())
    assert problem.startswith("not told nonsense://host/…: ")


def test_addresses_are_prefects_blocks() -> None:
    assert type(load_notification_block("json://127.0.0.1/hook")).__name__ == "AppriseNotificationBlock"


def test_a_second_inspection_of_the_portfolio_is_refused(tmp_path: Path) -> None:
    with (
        hold_portfolio(tmp_path),
        pytest.raises(StoreError) as raised,
        hold_portfolio(tmp_path),
    ):
        pass
    assert str(raised.value) == (
        f"another inspection of the portfolio is running with the lake {tmp_path}; wait until it ends"
    )


def test_an_inspection_gets_nothing_by_which_a_worker_controls_the_run_of_the_portfolio(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PREFECT__FLOW_RUN_ID", "that of the portfolio")
    monkeypatch.setenv("FACADELAKE_DEMO", "/demo")
    with SyncPrefectClient("http://127.0.0.1:9/api") as client:
        environment = make_environment(client)
    assert "PREFECT__FLOW_RUN_ID" not in environment
    assert environment["FACADELAKE_DEMO"] == "/demo"
    assert environment["PREFECT_API_URL"] == "http://127.0.0.1:9/api"
