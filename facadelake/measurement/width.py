"""Crack width from profiles: a dark slit convolved with a Gaussian point spread function is fitted to mean profiles.

For widths below about 1.5 standard deviations of the blur, width and contrast are correlated: only their product, the
equivalent width, is determined. Two constraints separate them. The shape of the profile does, as far as the blur is
known; and the contrast is nearly constant along one crack, so that its wide sections determine the contrast of its
narrow ones. The fit uses both at once. Where they do not suffice, the result is an upper limit and no width.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.special import erf

from facadelake.core.arrays import Float64Array, Float64N
from facadelake.measurement.blur import Blur
from facadelake.measurement.profiles import Profiles

_PROFILES_PER_BIN = 25
_MAX_BINS = 6
_CONTRAST_SIGMA = 0.05  # relative standard deviation of the contrast along one crack
_MODEL_SIGMA = 0.012  # standard deviation of a mean profile about the model: tone curve, sharpening, JPEG
_CORRELATION_LENGTH_PX = 3.0  # along the line: neighbouring profiles share pixels and texture
_TRIM_SHARE = 0.15  # share of the profiles left out at each end of the values at each offset
_SMOOTHING_PX = 2.0
_LARGEST_QUANTILE = 0.95  # quantile of the local widths taken as the largest width: the maximum is noise
_MIN_SIGMA_PX = 0.08  # lower limit of the standard deviation of the mean width
_MIN_WIDTH_PX = 1.0  # narrower widths cannot be separated from contrast, however well the blur is known
_MIN_CONTRAST = 0.5  # of a crack against the wall; a fainter line is narrower than it appears, or no crack
_RESOLVED_SIGMAS = 3.5  # width in standard deviations of the blur at which the two edges do not overlap
_MAX_RELATIVE_SIGMA = 0.35  # of a width; above it the width is a limit


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackWidth:
    """Width along a crack in px: mean with standard deviation, and largest.

    ``limit_px`` is the smallest mean width that could be resolved. ``is_resolved``: the mean is a measurement; else
    ``limit_px`` is an upper limit of it. ``blur_px`` and ``contrast`` are parameters of the fit.
    """

    mean_px: float
    sigma_px: float
    largest_px: float
    limit_px: float
    is_resolved: bool
    blur_px: float
    contrast: float


def fit_width(profiles: Profiles, blur: Blur) -> CrackWidth:
    """Fit blurred slits to the mean profiles of positions of similar equivalent width."""
    blur = replace(blur, sigma_px=float(np.hypot(blur.sigma_px, profiles.centre_sigma_px)))
    homogeneous = profiles.is_homogeneous
    darkness = profiles.darkness[homogeneous]
    equivalent = gaussian_filter1d(profiles.equivalent_width_px, _SMOOTHING_PX, mode="nearest")[homogeneous]
    bins = np.array_split(np.argsort(equivalent), min(max(len(equivalent) // _PROFILES_PER_BIN, 1), _MAX_BINS))
    means = [_compute_trimmed_mean(darkness[rows]) for rows in bins]
    weights = [1 / _estimate_noise(darkness[rows], mean) for rows, mean in zip(bins, means, strict=True)]
    areas = np.array([max(float(equivalent[rows].mean()), 0.02) for rows in bins])
    share = np.array([len(rows) for rows in bins]) / len(equivalent)
    fit = _ProfileFit(profiles.offset_px, means, weights, areas, blur)
    values, covariance = fit.solve()
    widths, contrasts, sigma = fit.extract_widths(values), fit.extract_contrasts(values), float(np.exp(values[0]))
    resolved = widths >= _RESOLVED_SIGMAS * sigma
    gradient = np.zeros(len(values))
    gradient[2 : 2 + len(bins)] = np.where(resolved, 0.0, share * widths)  # the parameters are logarithms of widths
    fit_sigma = float(np.sqrt(max(float(gradient @ covariance @ gradient), 0.0)))
    measured, noise = np.empty(len(equivalent)), np.empty(len(equivalent))
    for rows, width, contrast, area, is_resolved in zip(bins, widths, contrasts, areas, resolved, strict=True):
        if is_resolved:
            measured[rows], noise[rows] = _measure_half_maximum_widths(
                darkness[rows], profiles.offset_px, float(contrast), float(width)
            )
        else:
            measured[rows] = np.maximum(width + (equivalent[rows] - area) / contrast, 0.0)
            noise[rows] = np.std(profiles.background_width_px[homogeneous]) / contrast
    positions = np.arange(len(homogeneous))
    local = np.interp(positions, positions[homogeneous], measured)  # interpolated where a joint crosses the crack
    mean, mean_contrast = float(local.mean()), float(share @ contrasts)
    correlated = max(_CORRELATION_LENGTH_PX + mean, _estimate_correlation_length(profiles.background_width_px))
    independent = max(len(equivalent) / correlated, 1.0)
    scatter_sigma = float(np.sqrt(np.mean(noise**2) / independent))
    mean_sigma = float(np.hypot(np.hypot(fit_sigma, scatter_sigma), _MIN_SIGMA_PX))
    blur_sigma = sigma * float(np.sqrt(max(covariance[0, 0], 0.0)))
    # A slit of width w adds w**2 / 12 to the variance of the profile; a blur s with error e leaves 2 s e of it unknown.
    limit = max(_MIN_WIDTH_PX, float(np.sqrt(24 * sigma * blur_sigma)))
    is_measured = mean_contrast >= _MIN_CONTRAST and mean >= limit and mean_sigma <= _MAX_RELATIVE_SIGMA * mean
    if not is_measured:
        fwhm = _measure_mean_fwhm(means, profiles.offset_px, sigma)
        limit = max(limit, min(mean + 2 * mean_sigma, fwhm))
    return CrackWidth(
        mean_px=mean,
        sigma_px=mean_sigma,
        largest_px=max(float(np.quantile(local, _LARGEST_QUANTILE)), mean),
        limit_px=limit,
        is_resolved=is_measured,
        blur_px=sigma,
        contrast=mean_contrast,
    )


class _ProfileFit:
    """Weighted least-squares fit of slits with a common blur and nearly equal contrasts to mean profiles.

    Parameters: ln blur, ln contrast of the crack; then ln width, ln contrast and baseline of each profile.
    """

    def __init__(
        self, offset_px: Float64N, means: list[Float64N], weights: list[float], areas: Float64N, blur: Blur
    ) -> None:
        """Set up the fit.

        Args:
            offset_px: offsets (m,) of the samples from the centre of the crack.
            means: mean profiles, each (m,).
            weights: weight of each profile, 1 / standard deviation.
            areas: equivalent width of each profile in px.
            blur: prior of the blur.
        """
        self._offset, self._means, self._weights, self._areas, self._blur = offset_px, means, weights, areas, blur
        reach = areas.max() * 2 + 4 * blur.sigma_px + 2
        self._inside = np.abs(offset_px) <= max(reach, 5.0)

    def solve(self) -> tuple[Float64N, Float64Array]:
        """Estimated parameters (p,) and their covariance (p, p)."""
        count = len(self._areas)
        start, low, high = [np.log(self._blur.sigma_px), np.log(0.6)], [np.log(0.3), np.log(0.02)], [np.log(6.0), 0.03]
        start += [*np.log(self._areas / 0.6), *([np.log(0.6)] * count), *([0.0] * count)]
        low += [np.log(0.02)] * count + [np.log(0.015)] * count + [-0.1] * count
        high += [np.log(200.0)] * count + [0.08] * count + [0.1] * count
        initial = np.clip(start, np.array(low) + 1e-6, np.array(high) - 1e-6)
        result = least_squares(self._compute_residuals, initial, bounds=(low, high), x_scale=0.1, max_nfev=80)
        return result.x, np.linalg.pinv(result.jac.T @ result.jac)

    def extract_widths(self, values: Float64N) -> Float64N:
        """Widths in px of the profiles from the parameters."""
        return np.asarray(np.exp(values[2 : 2 + len(self._areas)]))

    def extract_contrasts(self, values: Float64N) -> Float64N:
        """Contrasts of the profiles from the parameters."""
        count = len(self._areas)
        return np.asarray(np.exp(values[2 + count : 2 + 2 * count]))

    def _compute_residuals(self, values: Float64N) -> Float64N:
        count = len(self._areas)
        blur, baselines = np.exp(values[0]), values[2 + 2 * count :]
        priors = [(values[0] - np.log(self._blur.sigma_px)) / self._blur.relative_sigma]
        priors += list((values[2 + count : 2 + 2 * count] - values[1]) / _CONTRAST_SIGMA)
        residuals = [np.array(priors)]
        offset = self._offset[self._inside]
        for mean, weight, width, contrast, baseline in zip(
            self._means,
            self._weights,
            self.extract_widths(values),
            self.extract_contrasts(values),
            baselines,
            strict=True,
        ):
            model = baseline + contrast * evaluate_blurred_slit(offset, float(width), float(blur))
            # Samples a quarter pixel apart are correlated: together they are weighted as samples of whole pixels.
            residuals.append((model - mean[self._inside]) * weight / 2)
        return np.concatenate(residuals)


def evaluate_blurred_slit(offset_px: Float64N, width_px: float, blur_px: float) -> Float64N:
    """A slit of depth 1 and ``width_px``, centred at 0, convolved with a Gaussian, at ``offset_px`` (m,)."""
    scale = np.sqrt(2) * blur_px
    value: Float64N = (erf((offset_px + width_px / 2) / scale) - erf((offset_px - width_px / 2) / scale)) / 2
    return value


def _measure_half_maximum_widths(
    darkness: Float64Array, offset_px: Float64N, contrast: float, width_px: float
) -> tuple[Float64N, Float64N]:
    """Widths (k,) of resolved profiles between the offsets where the darkness is half the contrast.

    The position of an edge depends little on the baseline, unlike the integral of a wide profile.

    Args:
        darkness: profiles (k, m).
        offset_px: offsets (m,) of the samples.
        contrast: contrast of the crack from the fit.
        width_px: width from the fit, which replaces edges that are not found.

    Returns:
        Widths (k,) and their standard deviations (k,), px.
    """
    half, centre = contrast / 2, len(offset_px) // 2
    step = float(offset_px[1] - offset_px[0])
    widths = np.zeros(len(darkness))
    for side in (darkness[:, centre:], darkness[:, centre::-1]):
        below = side < half
        below[:, 0] = False
        edge = np.where(below.any(axis=1), below.argmax(axis=1), round(width_px / 2 / step))
        number = np.arange(len(side))
        edge = np.clip(edge, 1, side.shape[1] - 1)
        before, after = side[number, edge - 1], side[number, edge]
        part = np.clip((before - half) / np.maximum(before - after, 1e-6), 0.0, 1.0)
        widths += (edge - 1 + part) * step
    median = float(np.median(widths))
    spread = 1.4826 * float(np.median(np.abs(widths - median)))
    widths = np.clip(widths, median - 3 * spread - 1, median + 3 * spread + 1)
    return widths, np.full(len(widths), max(spread, 0.1))


def _compute_trimmed_mean(rows: Float64Array) -> Float64N:
    """Trimmed mean (m,) of profiles (k, m) at each offset."""
    trimmed = int(_TRIM_SHARE * len(rows))
    ordered = np.sort(rows, axis=0)
    return np.asarray(ordered[trimmed : len(rows) - trimmed].mean(axis=0))


def _estimate_noise(rows: Float64Array, mean: Float64N) -> float:
    """Standard deviation of the mean profile (m,): scatter of the profiles (k, m), and errors of the model."""
    independent = max(len(rows) / _CORRELATION_LENGTH_PX, 1.0)
    return float(np.hypot(np.median(np.std(rows - mean, axis=0)) / np.sqrt(independent), _MODEL_SIGMA))


def _estimate_correlation_length(values: Float64N) -> float:
    """Integral of the autocorrelation of values (k,) up to its first zero crossing, in positions."""
    deviation = values - values.mean()
    covariance = np.correlate(deviation, deviation, mode="full")[len(deviation) - 1 :]
    if covariance[0] <= 0:
        return 1.0
    correlation = covariance / covariance[0]
    last = int(np.argmax(correlation < 0)) if (correlation < 0).any() else len(correlation)
    return float(2 * correlation[:last].sum() - 1)


def _measure_mean_fwhm(means: list[Float64N], offset_px: Float64N, blur_px: float) -> float:
    """Full width at half maximum in px of the mean profiles, an upper limit of the width."""
    profile = np.mean(means, axis=0)
    above_half = profile > profile[np.abs(offset_px) < blur_px].max() / 2
    centre = len(profile) // 2
    right = int(np.argmin(above_half[centre:])) if not above_half[centre:].all() else len(profile) - centre
    left = int(np.argmin(above_half[centre::-1])) if not above_half[: centre + 1].all() else centre
    return float((left + right) * (offset_px[1] - offset_px[0]))
