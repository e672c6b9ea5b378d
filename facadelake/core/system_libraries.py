"""Shared libraries of the operating system that the Python packages load, and the Debian packages that provide them.

Only the standard library is used: `scripts/bootstrap.py` imports this module with the system's python3, before anything
is installed.
"""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# Mesa's software renderer is one file up to 24.x and a separate library since.
SOFTWARE_RENDERERS = (
    "usr/lib/*/dri/swrast_dri.so",
    "usr/lib/*/libgallium-*.so",
    "usr/lib64/dri/swrast_dri.so",
    "usr/lib64/libgallium-*.so",
)


@dataclass(frozen=True, kw_only=True)
class Library:
    """A shared library, the Debian and Ubuntu package that provides it, and the Python packages that need it."""

    file: str
    package: str
    needed_by: str


LIBRARIES = (
    Library(file="libusb-1.0.so.0", package="libusb-1.0-0", needed_by="Open3D"),
    Library(file="libgomp.so.1", package="libgomp1", needed_by="Open3D"),
    Library(file="libGL.so.1", package="libgl1", needed_by="Open3D and pyrender"),
    Library(file="libEGL.so.1", package="libegl1", needed_by="pyrender, to render without a display"),
    Library(file="libEGL_mesa.so.0", package="libegl-mesa0", needed_by="pyrender, to render without a display"),
    Library(file="swrast_dri.so", package="libgl1-mesa-dri", needed_by="pyrender, to render without a GPU"),
)


def is_present(library: Library, root: Path = Path("/")) -> bool:
    """Whether the dynamic loader finds the library; Mesa's renderer is searched as a file below ``root``."""
    if library.file == "swrast_dri.so":
        return any(any(root.glob(pattern)) for pattern in SOFTWARE_RENDERERS)
    try:
        ctypes.CDLL(library.file)
    except OSError:
        return False
    return True


def format_install_command(packages: Sequence[str]) -> str:
    """The command that installs packages on Debian or Ubuntu."""
    return f"sudo apt-get update && sudo apt-get install -y --no-install-recommends {' '.join(packages)}"
