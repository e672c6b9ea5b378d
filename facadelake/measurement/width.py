"""A crack's width from its profiles: a dark bar blurred by a Gaussian.

Below about one and a half blurs a wider crack and a darker one look alike: only width times contrast shows. What tells
them apart is the shape of the profile, as far as the blur is known, and that one crack is about equally dark all along:
its wide places tell how dark, and its narrow ones follow. The fit does all of it at once; where the shapes do not tell,
there is a limit and no width.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.special import erf

from facadelake.core.arrays import Float64Array
from facadelake.measurement.blur import Blur
from facadelake.measurement.profiles import Profiles

_PROFILES_PER_BIN = 25
_MAX_BINS = 6
_CONTRAST_SIGMA = 0.05  # one sigma, as a share, of the contrast from place to place along one crack
_MODEL_SIGMA = 0.012  # one sigma of a mean profile about the model: tone curve, sharpening, JPEG
_CORRELATION_LENGTH_PX = 3.0  # along the line: neighbours share pixels and texture
_TRIM_SHARE = 0.15  # share of the profiles left out at each end, at every place across
_SMOOTH_PX = 2.0
_LARGEST_QUANTILE = 0.95  # quantile of the local widths that counts as the largest: the very largest is noise
_MIN_SIGMA_PX = 0.08  # of the mean width's error, whatever the fit says
_MIN_WIDTH_PX = 1.0  # no narrower width is told from a darker line, however well the blur is known
_MIN_CONTRAST = 0.5  # of the wall's light a crack swallows; what looks paler is narrower than it looks, or no crack
_RESOLVED_SIGMAS = 3.5  # blurs: so wide a bar's edges do not touch
_MAX_RELATIVE_SIGMA = 0.35  # a width whose sigma is a larger share of it is a limit


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackWidth:
    """Widths in px along a crack: mean, one sigma of it, largest, and ``local_px`` (k,).

    ``limit_px``: the narrowest mean that these profiles could have told. ``is_resolved``: whether the mean is a measurement;
    else the limit is its upper bound. ``blur_px`` and ``contrast`` are the fit's.
    """

    mean_px: float
    sigma_px: float
    largest_px: float
    limit_px: float
    is_resolved: bool
    blur_px: float
    contrast: float
    local_px: Float64Array


def fit_width(profiles: Profiles, blur: Blur) -> CrackWidth:
    """Fit the bars to the mean profiles of places about equally wide."""
    blur = replace(blur, sigma_px=float(np.hypot(blur.sigma_px, profiles.centre_sigma_px)))
    darkness = profiles.darkness[profiles.is_homogeneous]
    smooth = gaussian_filter1d(profiles.equivalent_width_px, _SMOOTH_PX, mode="nearest")[profiles.is_homogeneous]
    bins = np.array_split(np.argsort(smooth), min(max(len(smooth) // _PROFILES_PER_BIN, 1), _MAX_BINS))
    means = [_compute_trimmed_mean(darkness[rows]) for rows in bins]
    weights = [1 / _estimate_noise(darkness[rows], mean) for rows, mean in zip(bins, means, strict=True)]
    areas = np.array([max(float(smooth[rows].mean()), 0.02) for rows in bins])
    share = np.array([len(rows) for rows in bins]) / len(smooth)
    fit = _ProfileFit(profiles.offset_px, means, weights, areas, blur)
    values, covariance = fit.solve()
    widths, contrasts, sigma = fit.extract_widths(values), fit.extract_contrasts(values), float(np.exp(values[0]))
    wide = widths >= _RESOLVED_SIGMAS * sigma
    toward = np.zeros(len(values))
    toward[2 : 2 + len(bins)] = np.where(wide, 0.0, share * widths)  # widths are fitted as logarithms
    by_fit = float(np.sqrt(max(float(toward @ covariance @ toward), 0.0)))
    by_place, noise = np.empty(len(smooth)), np.empty(len(smooth))
    for rows, width, dark, area, resolved in zip(bins, widths, contrasts, areas, wide, strict=True):
        if resolved:
            by_place[rows], noise[rows] = _measure_half_maximum_widths(
                darkness[rows], profiles.offset_px, float(dark), float(width)
            )
        else:
            by_place[rows] = np.maximum(width + (smooth[rows] - area) / dark, 0.0)
            noise[rows] = np.std(profiles.background_width_px[profiles.is_homogeneous]) / dark
    places = np.arange(len(profiles.is_homogeneous))
    local = np.interp(
        places, places[profiles.is_homogeneous], by_place
    )  # a crack's width goes on where a joint crosses it
    mean, contrast = float(local.mean()), float(share @ contrasts)
    independent = max(
        len(smooth) / max(_CORRELATION_LENGTH_PX + mean, _estimate_correlation_length(profiles.background_width_px)),
        1.0,
    )
    by_scatter = float(np.sqrt(np.mean(noise**2) / independent))
    error = float(np.hypot(np.hypot(by_fit, by_scatter), _MIN_SIGMA_PX))
    blur_error = sigma * float(np.sqrt(max(covariance[0, 0], 0.0)))
    # A bar of width w adds w**2 / 12 to the profile's variance; a blur s known to e leaves 2 s e of it open.
    limit = max(_MIN_WIDTH_PX, float(np.sqrt(24 * sigma * blur_error)))
    told = contrast >= _MIN_CONTRAST and mean >= limit and error <= _MAX_RELATIVE_SIGMA * mean
    return CrackWidth(
        mean_px=mean,
        sigma_px=error,
        largest_px=max(float(np.quantile(local, _LARGEST_QUANTILE)), mean),
        limit_px=limit
        if told
        else max(limit, min(mean + 2 * error, _measure_mean_fwhm(means, profiles.offset_px, sigma))),
        is_resolved=told,
        blur_px=sigma,
        contrast=contrast,
        local_px=local,
    )


class _ProfileFit:
    """Bars with one blur and nearly one contrast, fitted to mean profiles (each (m,)) by weighted least squares.

    Parameters: ln blur, ln contrast of the crack; then ln width, ln contrast and base level of each profile.
    """

    def __init__(
        self, across_px: Float64Array, means: list[Float64Array], weights: list[float], areas: Float64Array, blur: Blur
    ) -> None:
        self._across, self._means, self._weights, self._areas, self._blur = across_px, means, weights, areas, blur
        reach = areas.max() * 2 + 4 * blur.sigma_px + 2
        self._seen = np.abs(across_px) <= max(reach, 5.0)

    def solve(self) -> tuple[Float64Array, Float64Array]:
        """Best parameters and their covariance."""
        count = len(self._areas)
        start, low, high = [np.log(self._blur.sigma_px), np.log(0.6)], [np.log(0.3), np.log(0.02)], [np.log(6.0), 0.03]
        start += [*np.log(self._areas / 0.6), *([np.log(0.6)] * count), *([0.0] * count)]
        low += [np.log(0.02)] * count + [np.log(0.015)] * count + [-0.1] * count
        high += [np.log(200.0)] * count + [0.08] * count + [0.1] * count
        begin = np.clip(start, np.array(low) + 1e-6, np.array(high) - 1e-6)
        found = least_squares(self._residuals, begin, bounds=(low, high), x_scale=0.1, max_nfev=80)
        return found.x, np.linalg.pinv(found.jac.T @ found.jac)

    def extract_widths(self, values: Float64Array) -> Float64Array:
        return np.asarray(np.exp(values[2 : 2 + len(self._areas)]))

    def extract_contrasts(self, values: Float64Array) -> Float64Array:
        count = len(self._areas)
        return np.asarray(np.exp(values[2 + count : 2 + 2 * count]))

    def _residuals(self, values: Float64Array) -> Float64Array:
        count = len(self._areas)
        blur, bases = np.exp(values[0]), values[2 + 2 * count :]
        out = [(values[0] - np.log(self._blur.sigma_px)) / self._blur.relative_sigma]
        out += list((values[2 + count : 2 + 2 * count] - values[1]) / _CONTRAST_SIGMA)
        parts = [np.array(out)]
        for mean, weight, width, contrast, base in zip(
            self._means, self._weights, self.extract_widths(values), self.extract_contrasts(values), bases, strict=True
        ):
            model = base + contrast * evaluate_blurred_slit(self._across[self._seen], float(width), float(blur))
            # Samples of a quarter pixel are not independent: together they count as those of whole pixels.
            parts.append((model - mean[self._seen]) * weight / 2)
        return np.concatenate(parts)


def evaluate_blurred_slit(across_px: Float64Array, width_px: float, blur_px: float) -> Float64Array:
    """A bar of height 1 and ``width_px`` about 0 under a Gaussian blur, at places (m,)."""
    scale = np.sqrt(2) * blur_px
    value: Float64Array = (erf((across_px + width_px / 2) / scale) - erf((across_px - width_px / 2) / scale)) / 2
    return value


def _measure_half_maximum_widths(
    darkness: Float64Array, across_px: Float64Array, contrast: float, width_px: float
) -> tuple[Float64Array, Float64Array]:
    """Widths (k,) of resolved bars by where darkness (k, m) falls to half the contrast, and one sigma of each.

    An edge is hardly moved by how bright the wall beside it is taken to be, unlike the integral of a wide bar.
    """
    half, middle = contrast / 2, len(across_px) // 2
    step = float(across_px[1] - across_px[0])
    out = np.zeros(len(darkness))
    for side in (darkness[:, middle:], darkness[:, middle::-1]):
        below = side < half
        below[:, 0] = False
        edge = np.where(below.any(axis=1), below.argmax(axis=1), round(width_px / 2 / step))
        number = np.arange(len(side))
        edge = np.clip(edge, 1, side.shape[1] - 1)
        before, after = side[number, edge - 1], side[number, edge]
        part = np.clip((before - half) / np.maximum(before - after, 1e-6), 0.0, 1.0)
        out += (edge - 1 + part) * step
    usual = float(np.median(out))
    spread = 1.4826 * float(np.median(np.abs(out - usual)))
    out = np.clip(out, usual - 3 * spread - 1, usual + 3 * spread + 1)
    return out, np.full(len(out), max(spread, 0.1))


def _compute_trimmed_mean(rows: Float64Array) -> Float64Array:
    """Mean (m,) of rows (k, m) at every place, without what is out of the way there."""
    cut = int(_TRIM_SHARE * len(rows))
    ordered = np.sort(rows, axis=0)
    return np.asarray(ordered[cut : len(rows) - cut].mean(axis=0))


def _estimate_noise(rows: Float64Array, mean: Float64Array) -> float:
    """One sigma of the mean profile: scatter about it, and what the model does not know."""
    independent = max(len(rows) / _CORRELATION_LENGTH_PX, 1.0)
    return float(np.hypot(np.median(np.std(rows - mean, axis=0)) / np.sqrt(independent), _MODEL_SIGMA))


def _estimate_correlation_length(values: Float64Array) -> float:
    """How many places (k,) tell as much as one: the sum of the autocorrelation to where it first falls below 0."""
    away = values - values.mean()
    along = np.correlate(away, away, mode="full")[len(away) - 1 :]
    if along[0] <= 0:
        return 1.0
    share = along / along[0]
    last = int(np.argmax(share < 0)) if (share < 0).any() else len(share)
    return float(2 * share[:last].sum() - 1)


def _measure_mean_fwhm(means: list[Float64Array], across_px: Float64Array, blur_px: float) -> float:
    """Full width at half of the mean profiles' depth: no crack is wider than it looks."""
    profile = np.mean(means, axis=0)
    deep = profile > profile[np.abs(across_px) < blur_px].max() / 2
    middle = len(profile) // 2
    right = int(np.argmin(deep[middle:])) if not deep[middle:].all() else len(profile) - middle
    left = int(np.argmin(deep[middle::-1])) if not deep[: middle + 1].all() else middle
    return float((left + right) * (across_px[1] - across_px[0]))
