"""What the service hands to others: systemd's unit, log lines as JSON, the container's files."""

from __future__ import annotations

import configparser
import json
import logging
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from cli.service.logs import JsonLines
from cli.service.systemd import format_unit
from facadelake.core.checkout import CHECKOUT


def test_the_unit_starts_the_service_of_the_settings() -> None:
    unit = configparser.RawConfigParser()
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string(format_unit(Path("/data/100% sure/facadelake.yaml"), "owner"))
    service = unit["Service"]
    assert service["User"] == "owner" and service["WorkingDirectory"] == str(CHECKOUT)
    assert service["ExecStart"].endswith('--foreground --json-logs --settings "/data/100%% sure/facadelake.yaml"')


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "facadelake.service"
    path.write_text(format_unit(tmp_path / "facadelake.yaml", "root"))
    done = subprocess.run(["systemd-analyze", "verify", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and str(path) not in done.stderr, done.stderr


def test_a_log_line_is_one_json_object() -> None:
    try:
        raise ValueError("two\nlines")
    except ValueError:
        record = logging.getLogger("facadelake.x").makeRecord(
            "facadelake.x", logging.ERROR, __file__, 1, "%s failed", ("Wand – süd",), sys.exc_info()
        )
    line = JsonLines().format(record)
    entry = json.loads(line)
    assert "\n" not in line and entry["message"] == "Wand – süd failed" and entry["level"] == "ERROR"
    assert "ValueError: two\nlines" in entry["exception"] and entry["time"].endswith("+00:00")


def test_the_container_runs_what_the_command_line_has() -> None:
    dockerfile = (CHECKOUT / "deploy" / "Dockerfile").read_text()
    assert 'CMD ["up", "--foreground", "--json-logs"]' in dockerfile and "make setup" in dockerfile
    service = yaml.safe_load((CHECKOUT / "deploy" / "compose.yaml").read_text())["services"]["facadelake"]
    context = (CHECKOUT / "deploy" / service["build"]["context"]).resolve()
    assert (context / service["build"]["dockerfile"]).is_file()
