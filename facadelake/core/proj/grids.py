"""Where PROJ finds transformation grids on this machine, and which there are.

The wheel of pyproj has no grids, and searches its own folder alone. Grids that the operating system or the user has
installed are found here: folders of the environment variables PROJ_DATA and PROJ_LIB, of Debian's package proj-data,
and the one that ``pyproj sync`` writes to. Grids are never downloaded.
"""

from __future__ import annotations

import os
from pathlib import Path

from pyproj import datadir, network

_SYSTEM_FOLDERS = ("/usr/share/proj", "/usr/local/share/proj")
_GRID_SUFFIXES = frozenset({".tif", ".tiff", ".gsb", ".gtx", ".gvb", ".gsa", ".json"})
# Grids in Debian's package proj-data, by their name in PROJ's database; the package has them under their older names.
_IN_DEBIAN_PACKAGE = frozenset(
    {
        "de_adv_BETA2007.tif",
        "ch_swisstopo_CHENyx06a.tif",
        "ch_swisstopo_CHENyx06_ETRS.tif",
        "us_nga_egm96_15.tif",
        "fr_ign_ntf_r93.tif",
        "nz_linz_nzgd2kgrid0005.tif",
    }
)


def use_installed_grids() -> None:
    """Let PROJ search the folders of installed grids after its own, and never the network."""
    network.set_network_enabled(active=False)
    searched = datadir.get_data_dir().split(os.pathsep)
    for folder in list_grid_folders():
        if str(folder) not in searched:
            datadir.append_data_dir(str(folder))
            searched.append(str(folder))


def list_grid_folders() -> tuple[Path, ...]:
    """The existing folders of installed grids, without PROJ's own."""
    named = [part for name in ("PROJ_DATA", "PROJ_LIB") for part in os.environ.get(name, "").split(os.pathsep)]
    candidates = [*filter(None, named), datadir.get_user_data_dir(), *_SYSTEM_FOLDERS]
    return tuple(dict.fromkeys(folder for folder in map(Path, candidates) if folder.is_dir()))


def list_installed_grids() -> tuple[tuple[str, int], ...]:
    """Name and size in bytes of every installed grid, for keys of results that PROJ computes."""
    files = (path for folder in list_grid_folders() for path in folder.iterdir() if path.suffix in _GRID_SUFFIXES)
    return tuple(sorted((path.name, path.stat().st_size) for path in files if path.is_file()))


def describe_grid_installation(grids: tuple[str, ...]) -> str:
    """How the missing grids are installed, for messages."""
    if not grids:
        return "update PROJ's data"
    command = " ".join(f"--file {grid}" for grid in grids)
    debian = "apt install proj-data, or " if set(grids) <= _IN_DEBIAN_PACKAGE else ""
    return f"install {'it' if len(grids) == 1 else 'them'} ({debian}pyproj sync {command})"
