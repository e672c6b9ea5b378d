"""Prefect's server: that of the running service is used, else a temporary one per run."""

from __future__ import annotations

import os
import urllib.request
from pathlib import Path

ADDRESS_FILE = "api_url"


def get_prefect_home(lake: Path) -> Path:
    """Folder of Prefect's database and settings, in the lake."""
    return lake.resolve() / "prefect"


def find_running_server(lake: Path) -> str | None:
    """Address of the server of ``facadelake up`` for this lake, None where none answers."""
    file = get_prefect_home(lake) / ADDRESS_FILE
    if not file.is_file():
        return None
    url = file.read_text().strip()
    return url if is_healthy(url) else None


def is_healthy(url: str) -> bool:
    """Whether a Prefect server answers at ``url``."""
    try:
        with urllib.request.urlopen(f"{url}/health", timeout=2) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def configure_prefect(lake: Path) -> None:
    """Set environment variables of Prefect that the user has not set: home in the lake, quiet console, logs."""
    home = get_prefect_home(lake)
    home.mkdir(parents=True, exist_ok=True)
    defaults = {
        "PREFECT_HOME": str(home),
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "ERROR",
        "PREFECT_LOGGING_EXTRA_LOGGERS": "facadelake",
        "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "180",
    }
    if "PREFECT_API_URL" not in os.environ:
        url = find_running_server(lake)
        if url:
            defaults["PREFECT_API_URL"] = url
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
