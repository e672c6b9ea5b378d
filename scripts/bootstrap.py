"""Make `make setup` work on a fresh Debian or Ubuntu: check Python and system libraries, put uv into .tools/bin.

Runs with the system's python3 and the standard library alone. What is missing is installed where the user is root;
otherwise the one command that installs all of it is printed and the exit status is 1. Changes nothing when all is
there. Debian's python3 is externally managed and may lack venv and pip: uv comes from the PATH, from a virtual
environment of its own, or through pip's --target, never into the system's Python.
"""

import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
UV_FOLDER = REPOSITORY / ".tools" / "uv"
UV = REPOSITORY / ".tools" / "bin" / "uv"
REQUIREMENTS = REPOSITORY / "scripts" / "uv-requirements.txt"
# Versions of uv that read the lock file; any of them on the PATH will do instead of the pinned one.
UV_OLDEST, UV_BEFORE = (0, 9), (1, 0)
PYTHON_OLDEST, PYTHON_BEFORE = (3, 11), (3, 14)


def stop(message):
    """Say what is wrong and how to mend it, and leave with status 1."""
    sys.stdout.flush()
    sys.stderr.write(f"\nsetup: {message}\n")
    sys.exit(1)


def check_python():
    """Go on with a python3 that the dependencies have wheels for, or stop; any Python >= 3.7 reads this far."""
    system, machine = platform.system(), platform.machine()
    if (system, machine) != ("Linux", "x86_64"):
        stop(f"this is {system} on {machine}; pycolmap comes for Linux on x86_64 alone.")
    if PYTHON_OLDEST <= sys.version_info[:2] < PYTHON_BEFORE:
        return
    for minor in (13, 12, 11):
        other = shutil.which(f"python3.{minor}")
        if other:
            sys.stdout.flush()
            os.execv(other, [other, str(Path(__file__).resolve())])
    stop(
        f"python3 is {platform.python_version()}; Facadelake needs 3.11, 3.12 or 3.13. Install one of them as "
        "python3.11, python3.12 or python3.13 (the python3 of Debian 12 and 13 and of Ubuntu 24.04 will do) and "
        "run make again."
    )


def uv_version(program):
    """(major, minor) of a uv, or (0, 0) where it cannot be run."""
    try:
        said = subprocess.run([str(program), "--version"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return (0, 0)
    found = re.match(r"uv (\d+)\.(\d+)", said)
    return (int(found.group(1)), int(found.group(2))) if found else (0, 0)


def usable_uv():
    """Path of a uv that reads the lock file, ours first; None where there is none."""
    on_path = shutil.which("uv")
    for program in (UV, Path(on_path) if on_path else None):
        if program and UV_OLDEST <= uv_version(program) < UV_BEFORE:
            return program
    return None


def has(module):
    """True where this python3 has a module, also one installed a moment ago."""
    importlib.invalidate_caches()
    return importlib.util.find_spec(module) is not None


def missing_packages():
    """Debian packages to install: system libraries, and python3-venv where uv cannot be had without it."""
    missing = [library for library in LIBRARIES if not is_present(library)]
    for library in missing:
        print(f"setup: {library.file} is missing ({library.needed_by})")
    packages = [library.package for library in missing]
    if not usable_uv() and not has("ensurepip") and not has("pip"):
        print("setup: this python3 has neither ensurepip nor pip (to fetch uv)")
        packages.insert(0, "python3-venv")
    return packages


def install(packages):
    """Install Debian packages as root, or stop and print the one command that does."""
    if not shutil.which("apt-get"):
        stop(f"apt-get is not here; install what Debian calls {' '.join(packages)} and run make again.")
    if os.geteuid() != 0:
        stop(f"run this once, then make again:\n\n    {format_install_command(packages)}\n")
    print(f"setup: installing {' '.join(packages)}", flush=True)
    for arguments in (["update", "-q"], ["install", "-q", "-y", "--no-install-recommends", *packages]):
        done = subprocess.run(
            ["apt-get", *arguments],
            env=dict(os.environ, DEBIAN_FRONTEND="noninteractive"),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        if done.returncode:
            stop(f"apt-get {' '.join(arguments)} failed:\n{done.stdout[-3000:]}")
    still = missing_packages()
    if still:
        stop(f"installed, yet the loader finds nothing of {' '.join(still)}. Run ldconfig and make again.")


def fetch_uv():
    """The pinned uv, checked by its hash, in a folder of its own; return the program's path."""
    print("setup: fetching uv", flush=True)
    shutil.rmtree(UV_FOLDER, ignore_errors=True)
    python, folder = sys.executable, str(UV_FOLDER)
    what = [
        "--quiet",
        "--disable-pip-version-check",
        "--require-hashes",
        "--only-binary=:all:",
        "-r",
        str(REQUIREMENTS),
    ]
    if has("ensurepip"):
        commands = [[python, "-m", "venv", folder], [f"{folder}/bin/python", "-m", "pip", "install", *what]]
    else:
        commands = [[python, "-m", "pip", "install", "--target", folder, *what]]
    for command in commands:
        if subprocess.run(command, stdin=subprocess.DEVNULL).returncode:
            stop(f"uv could not be fetched; this failed:\n\n    {' '.join(command)}\n")
    return UV_FOLDER / "bin" / "uv"


if __name__ == "__main__":
    check_python()
    # By its folder: importing the package facadelake needs what is not installed yet. Only now: it needs Python 3.11.
    sys.path.insert(0, str(REPOSITORY / "facadelake" / "core"))
    from system_libraries import LIBRARIES, format_install_command, is_present

    wanted = missing_packages()
    if wanted:
        install(wanted)
    found = usable_uv() or fetch_uv()
    if found != UV:
        UV.parent.mkdir(parents=True, exist_ok=True)
        if UV.is_symlink():
            UV.unlink()
        UV.symlink_to(found)
