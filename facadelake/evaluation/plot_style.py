"""Style of the plots of all evaluations."""

from __future__ import annotations

from matplotlib.axes import Axes


def format_axes(axes: Axes, x: str, y: str) -> None:
    """Label the axes ``x`` and ``y``, draw a light grid behind the data, and hide the upper and right spines."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
