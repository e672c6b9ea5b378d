"""How the command line talks to Prefect: a server that is there, else a temporary one; quiet either way.

Import this module before ``prefect``: its settings are read when it is first imported.
"""

from __future__ import annotations

import os
import urllib.request
from pathlib import Path

ADDRESS_FILE = "api_url"


def prefect_home(lake: Path) -> Path:
    """Prefect's own database and settings, kept beside the lake's tables."""
    return lake.resolve() / "prefect"


def running_server(lake: Path) -> str | None:
    """Address of the server that ``facadelake serve-prefect`` runs for this lake, if it answers."""
    file = prefect_home(lake) / ADDRESS_FILE
    if not file.is_file():
        return None
    url = file.read_text().strip()
    try:
        with urllib.request.urlopen(f"{url}/health", timeout=2) as answer:
            return url if answer.status == 200 else None
    except OSError:
        return None


def prepare(lake: Path) -> None:
    """Set Prefect's environment where the person has not: home in the lake, a quiet console, logs to its page."""
    home = prefect_home(lake)
    home.mkdir(parents=True, exist_ok=True)
    defaults = {
        "PREFECT_HOME": str(home),
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "ERROR",
        "PREFECT_LOGGING_EXTRA_LOGGERS": "facadelake",
        "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "180",
    }
    if "PREFECT_API_URL" not in os.environ:
        url = running_server(lake)
        if url:
            defaults["PREFECT_API_URL"] = url
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
