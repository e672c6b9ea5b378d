"""The worker's modules, tested in a process of their own: pycolmap must not load beside OpenCV."""

import subprocess
import sys
from pathlib import Path


def test_the_workers_modules() -> None:
    inside = Path(__file__).with_name("inside_worker.py")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(inside)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
