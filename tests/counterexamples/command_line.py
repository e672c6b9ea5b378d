"""The command line as a person has it: a process of its own, its exit code and what it says."""

import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def facadelake(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``facadelake`` with the arguments; the console is wide enough that no line is broken."""
    return subprocess.run(
        [sys.executable, "-c", "from cli.main import main; main()", *map(str, arguments)],
        cwd=REPOSITORY,
        env=os.environ | {"COLUMNS": "4000"} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
