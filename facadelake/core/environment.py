"""Environment defaults that keep every library from phoning home, looking for updates or opening a window.

Set when `facadelake`, `flows` or `tasks` is first imported, because several libraries read them once, at their own
import. They are defaults: whoever sets a variable keeps that value.
"""

import os
from collections.abc import Mapping

DEFAULTS: Mapping[str, str] = {
    # The convention many tools follow, see consoledonottrack.com. Prefect's SDK analytics read it at import.
    "DO_NOT_TRACK": "1",
    # Prefect's server: a heartbeat every ten minutes, and banners in its UI.
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
    # Great Expectations: usage statistics of releases before 1.24; 1.24 only names the variable.
    "GX_ANALYTICS_ENABLED": "false",
    # ONNX Runtime >= 1.29 uploads process and model events from Linux too and leaves a device identifier on disk;
    # only this variable, set before its first import, stops both.
    "ORT_DISABLE_TELEMETRY": "1",
    # PROJ must not fetch grids by itself: a missing grid is our error to report, not a download.
    "PROJ_NETWORK": "OFF",
    # Rendering without a display; pyrender imports pyglet, which would want X11's libraries.
    "PYOPENGL_PLATFORM": "egl",
    "PYGLET_HEADLESS": "true",
    # Plots are files, never windows.
    "MPLBACKEND": "Agg",
}


def set_environment_defaults() -> None:
    """Set each default of DEFAULTS that the environment does not set; child processes inherit them."""
    for name, value in DEFAULTS.items():
        os.environ.setdefault(name, value)
