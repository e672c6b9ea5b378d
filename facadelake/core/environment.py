"""Environment defaults that turn off the telemetry, update checks and windows of the libraries.

They are set when `facadelake`, `flows` or `tasks` is first imported, because several libraries read them once, at their
own import. A variable that the environment sets already keeps its value.
"""

import os
from collections.abc import Mapping

DEFAULTS: Mapping[str, str] = {
    # The convention many tools follow, see consoledonottrack.com. Prefect's SDK analytics read it at import.
    "DO_NOT_TRACK": "1",
    # Prefect's server: a heartbeat every ten minutes, and banners in its UI.
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
    # Great Expectations: usage statistics of releases before 1.24; 1.24 mentions the variable without using it.
    "GX_ANALYTICS_ENABLED": "false",
    # ONNX Runtime >= 1.29 uploads process and model events on Linux too and stores a device identifier on disk; only
    # this variable, set before its first import, disables both.
    "ORT_DISABLE_TELEMETRY": "1",
    # PROJ must not download grids: a missing grid is reported as an error.
    "PROJ_NETWORK": "OFF",
    # Rendering without a display; pyrender imports pyglet, which otherwise needs X11.
    "PYOPENGL_PLATFORM": "egl",
    "PYGLET_HEADLESS": "true",
    # Plots are written to files; no window is opened.
    "MPLBACKEND": "Agg",
}


def set_environment_defaults() -> None:
    """Set each default of DEFAULTS that the environment does not set; child processes inherit them."""
    for name, value in DEFAULTS.items():
        os.environ.setdefault(name, value)
