"""The unit of systemd that starts the service with the machine."""

from __future__ import annotations

import getpass
import sys
from pathlib import Path

from facadelake.core.checkout import CHECKOUT

_UNIT = """\
# Written by 'facadelake systemd-unit'.
[Unit]
Description=Facadelake: inspections of buildings by schedule
After=network-online.target
Wants=network-online.target

[Service]
Type=exec
User={user}
WorkingDirectory={checkout}
ExecStart="{python}" -c "from cli.main import main; main()" up --foreground --json-logs --settings "{settings}"
Restart=on-failure
RestartSec=10
# The supervisor ends its children in order; what is left after that is killed.
KillMode=mixed
TimeoutStopSec=60

[Install]
WantedBy=multi-user.target
"""


def format_unit(settings: Path, user: str | None) -> str:
    """The text of the unit, for the file of settings and the user that it runs as (None: the one who asks)."""
    return _UNIT.format(
        user=user or getpass.getuser(), checkout=CHECKOUT, python=sys.executable, settings=settings
    ).replace("%", "%%")
