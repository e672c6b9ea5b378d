"""Plots of a comparison with truth: size and place of the errors, consistency of the covariances, and views."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.stats import chi2

from facadelake.core.arrays import Float64N
from facadelake.evaluation.campaigns.comparison import TruthComparison
from facadelake.evaluation.campaigns.covariance_consistency import CHI_SQUARE_95, compute_normalised_squared_errors
from facadelake.evaluation.campaigns.samples import PositionSamples
from facadelake.evaluation.plot_style import format_axes

_DPI = 130
_FLOOR_CM = 0.01  # least error on a logarithmic axis
# Colours of Okabe and Ito 2008, with a marker and a line style each for prints without colour.
_STYLE = {
    "cameras": ("#e69f00", "^", "dotted"),
    "rays": ("#595959", "x", "dashdot"),
    "observations": ("#0072b2", ".", "dashed"),
    "defects": ("#d55e00", "o", "solid"),
}
_POSITIONED = ("observations", "defects")
_ARROW_SHARE_MAX = 0.2  # longest arrow as a share of the extent of the defects


def write_plots(compared: TruthComparison, folder: Path, title: str) -> list[Path]:
    """Write the plots as PNG into ``folder`` and return their paths; ``title`` is that of building and campaign.

    ``errors``: distribution. ``vectors``: from above and from two sides. ``deviation``: along the normal, against the
    triangulated deviation from the model. ``sigmas``: normalised errors against chi-square. ``views``: by incidence and
    distance. A plot without samples is not written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, draw in (
        ("errors", _plot_errors),
        ("vectors", _plot_vectors),
        ("deviation", _plot_deviation),
        ("sigmas", _plot_sigmas),
        ("views", _plot_views),
    ):
        figure = Figure(dpi=_DPI, facecolor="white", layout="constrained")
        FigureCanvasAgg(figure)
        if draw(figure, compared):
            figure.suptitle(f"{title}: {_TITLES[name]}", fontsize=11, ha="left", x=0.01, parse_math=False)
            path = folder / f"{name}.png"
            figure.savefig(path)
            written.append(path)
    return written


_TITLES = {
    "errors": "errors against truth",
    "vectors": "error vectors (estimated minus true)",
    "deviation": "errors along the surface's normal",
    "sigmas": "consistency of the covariances (NEES)",
    "views": "errors of observations by view",
}


def _plot_errors(figure: Figure, compared: TruthComparison) -> bool:
    """Cumulative distribution of the errors, and histograms of observations and defects."""
    sizes = {
        "cameras": np.linalg.norm(compared.cameras.error_site_m, axis=1),
        "rays": compared.ray_error_m,
        "observations": compared.observations.size_m,
        "defects": compared.defects.size_m,
    }
    if not any(len(size) for size in sizes.values()):
        return False
    figure.set_size_inches(11, 4.4)
    shares, counts = figure.subplots(1, 2)
    for name, size in sizes.items():
        if not len(size):
            continue
        colour, _, line = _STYLE[name]
        ordered = np.sort(np.maximum(100 * size, _FLOOR_CM))
        share = np.arange(1, len(ordered) + 1) / len(ordered)
        p95 = np.percentile(100 * size, 95)
        shares.step(ordered, share, where="post", color=colour, linestyle=line, label=f"{name} (p95 {p95:.2g} cm)")
    shares.axhline(0.95, color="#999999", linewidth=0.8)
    shares.set_xscale("log")
    shares.set_ylim(0, 1.01)
    shares.legend(loc="lower right", fontsize=8)
    format_axes(shares, "error (cm), logarithmic", "share of samples below")
    widest = max((np.percentile(100 * sizes[name], 95) for name in _POSITIONED if len(sizes[name])), default=1.0)
    bins = np.linspace(0, max(widest, _FLOOR_CM), 41)
    for name in _POSITIONED:
        if not len(sizes[name]):
            continue
        colour, _, line = _STYLE[name]
        beyond = int((100 * sizes[name] > bins[-1]).sum())
        counts.hist(
            100 * sizes[name], bins=bins, weights=np.full(len(sizes[name]), 1 / len(sizes[name])), histtype="step",
            color=colour, linestyle=line, linewidth=1.6, label=f"{name}, {len(sizes[name])} ({beyond} beyond)",
        )  # fmt: skip
    if counts.patches:
        counts.legend(fontsize=8)
    format_axes(counts, "3D error (cm)", "share of samples")
    return True


def _plot_vectors(figure: Figure, compared: TruthComparison) -> bool:
    """Cameras and defects from above and from two sides with error vectors, scaled by one factor; vectors
    longer than a fifth of the extent are shortened and red."""
    defects = compared.defects
    if not len(defects.ids):
        return False
    figure.set_size_inches(13, 5.2)
    extent = float(np.ptp(defects.xyz_true_site_m, axis=0).max()) or 1.0
    typical_m = max(float(np.median(defects.size_m)), 1e-5)
    factor = 10.0 ** np.floor(np.log10(0.1 * extent / typical_m))
    for axes, (i, j), view, names in zip(
        figure.subplots(1, 3),
        ((0, 1), (0, 2), (1, 2)),
        ("from above", "seen to the north", "seen to the west"),
        (("east", "north"), ("east", "up"), ("north", "up")),
        strict=True,
    ):
        shortened = False
        for name, position, error in (
            ("cameras", compared.xyz_camera_m - compared.cameras.error_site_m, compared.cameras.error_site_m),
            ("defects", defects.xyz_true_site_m, defects.error_site_m),
        ):
            colour, marker, _ = _STYLE[name]
            axes.scatter(position[:, i], position[:, j], s=9, color=colour, marker=marker, label=name)
            length = factor * np.linalg.norm(error, axis=1)
            cut = length > _ARROW_SHARE_MAX * extent
            shortened = shortened or bool(cut.any())
            arrow = factor * error * np.where(cut, _ARROW_SHARE_MAX * extent / np.maximum(length, 1e-12), 1.0)[:, None]
            axes.quiver(
                position[:, i], position[:, j], arrow[:, i], arrow[:, j], color=np.where(cut, "#cc0000", "#333333"),
                angles="xy", scale_units="xy", scale=1.0, width=0.003,
            )  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{view}, errors x {factor:g}{'; red: shortened' if shortened else ''}", fontsize=9)
        format_axes(axes, f"{names[0]} (m)", f"{names[1]} (m)")
        if (i, j) == (0, 1):
            axes.legend(fontsize=8)
    return True


def _plot_deviation(figure: Figure, compared: TruthComparison) -> bool:
    """Errors along the normal of observations and defects; with triangulated defects also against their deviation."""
    parts = {"observations": compared.observations, "defects": compared.defects}
    if not any(len(part.ids) for part in parts.values()):
        return False
    measured = np.isfinite(compared.defects.deviation_m)
    figure.set_size_inches(11 if measured.any() else 5.8, 4.4)
    panels = figure.subplots(1, 2 if measured.any() else 1, squeeze=False)[0]
    left = panels[0]
    errors_cm = {name: 100 * _project_on_normal(part) for name, part in parts.items()}
    widest = max(float(np.percentile(np.abs(along), 95)) for along in errors_cm.values() if len(along)) or 1.0
    for name, along in errors_cm.items():
        if not len(along):
            continue
        colour, _, line = _STYLE[name]
        left.hist(
            along, bins=np.linspace(-widest, widest, 41), weights=np.full(len(along), 1 / len(along)), histtype="step",
            color=colour, linestyle=line, linewidth=1.6, label=f"{name}: median {np.median(along):+.2g} cm",
        )  # fmt: skip
    left.axvline(0, color="#999999", linewidth=0.8)
    left.legend(fontsize=8)
    format_axes(left, "error along the outward normal (cm)", "share of samples")
    if not measured.any():
        return True
    right = panels[1]
    colour, marker, _ = _STYLE["defects"]
    right.scatter(
        100 * compared.defects.deviation_m[measured], errors_cm["defects"][measured], s=12, color=colour, marker=marker
    )
    right.axhline(0, color="#999999", linewidth=0.8)
    format_axes(right, "measured deviation from the model (cm)", "error along the normal (cm)")
    return True


def _project_on_normal(samples: PositionSamples) -> Float64N:
    along: Float64N = (samples.error_site_m * samples.normal_site).sum(axis=1)
    return along


def _plot_sigmas(figure: Figure, compared: TruthComparison) -> bool:
    """Quantiles of the normalised squared errors against chi-square with 3 degrees of freedom."""
    squares = {
        "cameras": compute_normalised_squared_errors(compared.cameras.error_site_m, compared.cameras.covariance_m2),
        "observations": compute_normalised_squared_errors(
            compared.observations.error_site_m, compared.observations.covariance_m2
        ),
        "defects": compute_normalised_squared_errors(compared.defects.error_site_m, compared.defects.covariance_m2),
    }
    if not any(len(found) for found in squares.values()):
        return False
    figure.set_size_inches(6.4, 5.6)
    axes = figure.subplots()
    for name, found in squares.items():
        if not len(found):
            continue
        colour, marker, _ = _STYLE[name]
        expected = chi2.ppf((np.arange(len(found)) + 0.5) / len(found), 3)
        inside = float(np.mean(found <= CHI_SQUARE_95))
        axes.plot(
            expected, np.maximum(np.sort(found), 1e-3), linestyle="none", marker=marker, markersize=4, color=colour,
            label=f"{name}: {inside:.0%} inside 2 sigma",
        )  # fmt: skip
    line = np.array([1e-2, 30.0])
    axes.plot(line, line, color="#000000", linewidth=1.0, label="consistent")
    axes.axhline(CHI_SQUARE_95, color="#999999", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.legend(fontsize=8, loc="upper left")
    format_axes(axes, "expected normalised squared error (above the line: covariance too small)", "observed")
    return True


def _plot_views(figure: Figure, compared: TruthComparison) -> bool:
    """Errors of observations against incidence and distance, with medians of twelve groups of equal size."""
    observations = compared.observations
    if not (np.isfinite(observations.incidence_deg) & np.isfinite(observations.distance_m)).any():
        return False
    figure.set_size_inches(11, 4.4)
    size = np.maximum(100 * observations.size_m, _FLOOR_CM)
    for axes, values, name in zip(
        figure.subplots(1, 2),
        (observations.incidence_deg, observations.distance_m),
        ("incidence (deg)", "distance (m)"),
        strict=True,
    ):
        known = np.isfinite(values)
        colour, marker, _ = _STYLE["observations"]
        axes.scatter(values[known], size[known], s=26, color=colour, marker=marker, alpha=0.35, linewidths=0)
        order = np.argsort(values[known])
        parts = [part for part in np.array_split(order, 12) if len(part)]
        axes.plot(
            [np.median(values[known][part]) for part in parts], [np.median(size[known][part]) for part in parts],
            color="#000000", linewidth=1.5, label="median of a group",
        )  # fmt: skip
        axes.set_yscale("log")
        axes.legend(fontsize=8)
        format_axes(axes, name, "3D error (cm), logarithmic")
    return True
