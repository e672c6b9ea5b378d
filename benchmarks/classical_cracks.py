"""A classical crack detector, for comparison with trained ones: ridge filter, hysteresis threshold, linked components.

    .venv/bin/python -m benchmarks.classical_cracks tune     # prints the best settings on the training sites

Dark ridges are found at several scales by the eigenvalues of the Hessian (Frangi et al., MICCAI 1998), relative to the
photograph's texture, and thresholded with hysteresis (Canny 1986). Components with small gaps between them are linked.
The score of a component is a logistic function of its length, contrast and slenderness. Settings and score were chosen
on training and validation sites only, never on test sites.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product

import cv2
import numpy as np
from scipy.optimize import minimize
from skimage.filters import apply_hysteresis_threshold
from skimage.morphology import skeletonize

from facadelake.core.arrays import Float64Array, UInt8Image
from facadelake.detection import Box
from facadelake.detection.inference import DetectedBox
from facadelake.evaluation.detectors.average_precision import compute_average_precision, match_predictions
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import ImagePredictions, Prediction, read_pixels
from schemas.vocabulary import DefectClass

_SIDE_PX = 640  # larger photographs are reduced to it, to suppress texture finer than cracks
_SCALES_PX = (1.5, 2.5, 4.0)
_FLAT_PX = 20.0  # sigma of the background that is subtracted: variations of light and stains


@dataclass(frozen=True, kw_only=True)
class RidgeFilterSettings:
    """Settings of the ridge filter.

    ``low``, ``high``: hysteresis thresholds in units of the median ridge strength. ``gap_px``: widest gap over which
    components are linked. ``least``: smallest length of a component as a share of the longer side of the photograph.
    ``weights`` of the score: offset, log of length as a share of the side, log of contrast over ``low``, log of length
    over area.
    """

    low: float = 4.0
    high: float = 9.0
    gap_px: int = 9
    least: float = 0.1
    weights: tuple[float, float, float, float] = (0.0, 1.0, 1.0, 0.0)


# The best of 15 settings on 137 photographs of training and validation sites (AP50 0.289), found by ``tune``.
TUNED = RidgeFilterSettings(low=2.5, high=6.25, gap_px=7, least=0.1, weights=(-6.803, 1.917, -0.823, -4.085))


class RidgeCrackFilter:
    """Detects cracks by their ridges; it has no other class."""

    name = "classical ridge filter"

    def __init__(self, settings: RidgeFilterSettings = TUNED, threshold: float = 0.5) -> None:
        self._settings = settings
        self.threshold = threshold
        self.sha256 = hashlib.sha256(json.dumps(asdict(settings)).encode()).hexdigest()

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions:
        """Boxes of all components, with their scores."""
        strength, gain = filter_photograph(pixels_bgr)
        found = tuple(
            DetectedBox(box=box, score=compute_score(features, self._settings), class_name=str(DefectClass.CRACK))
            for box, features in find_cracks(strength, gain, self._settings)
        )
        return ImagePredictions(
            above_floor=found, above_threshold=tuple(one for one in found if one.score >= self.threshold)
        )


def filter_photograph(pixels_bgr: UInt8Image) -> tuple[Float64Array, float]:
    """Ridge strength (h, w) of a photograph, reduced if it is large, and the gain: its pixels per original pixel."""
    gain = min(1.0, _SIDE_PX / max(pixels_bgr.shape[:2]))
    grey = cv2.cvtColor(pixels_bgr, cv2.COLOR_BGR2GRAY)
    if gain < 1:
        grey = cv2.resize(grey, None, fx=gain, fy=gain, interpolation=cv2.INTER_AREA)
    return compute_ridge_strength(np.asarray(grey, dtype=np.uint8)), gain


def find_cracks(strength: Float64Array, gain: float, settings: RidgeFilterSettings) -> list[tuple[Box, Float64Array]]:
    """Boxes in pixels of the photograph, and features (4,), of the components."""
    return [
        (Box(x_px=x / gain, y_px=y / gain, width_px=w / gain, height_px=h / gain), features)
        for (x, y, w, h), features in find_components(strength, settings)
    ]


def compute_score(features: Float64Array, settings: RidgeFilterSettings) -> float:
    """Score of a component, 0 to 1, from its features (4,)."""
    return float(1 / (1 + np.exp(-features @ np.array(settings.weights))))


def compute_ridge_strength(grey: UInt8Image) -> Float64Array:
    """Strength (h, w) of dark ridges in a grey image (h, w), in units of its median over pixels with a ridge."""
    values = np.log(grey.astype(np.float32) + 8.0)
    values -= cv2.GaussianBlur(values, (0, 0), _FLAT_PX)
    best = np.zeros_like(values)
    for sigma in _SCALES_PX:
        smooth = cv2.GaussianBlur(values, (0, 0), sigma)
        xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3) / 4
        yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3) / 4
        xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3) / 4
        half, root = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
        across, along = half + root, half - root
        best = np.maximum(best, sigma**2 * (across - np.abs(along)))
    positive = best[best > 0]
    strength: Float64Array = (best / (np.median(positive) if len(positive) else 1.0)).astype(np.float64)
    return strength


def find_components(
    strength: Float64Array, settings: RidgeFilterSettings
) -> list[tuple[tuple[int, int, int, int], Float64Array]]:
    """Box (left, top, width, height) and features (4,) of every linked component of sufficient length."""
    lines = apply_hysteresis_threshold(strength, settings.low, settings.high)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (settings.gap_px, settings.gap_px))
    linked = cv2.dilate(lines.astype(np.uint8), reach)
    count, labels, _, _ = cv2.connectedComponentsWithStats(linked, connectivity=8)
    labels = np.where(lines, labels, 0)
    thin = np.where(skeletonize(lines), labels, 0)
    area = np.bincount(labels.ravel(), minlength=count)
    length = np.bincount(thin.ravel(), minlength=count)
    contrast = np.bincount(labels.ravel(), weights=strength.ravel(), minlength=count) / np.maximum(area, 1)
    side = max(strength.shape)
    found = []
    for label in np.flatnonzero(length >= settings.least * side).tolist():
        if label == 0:
            continue
        rows, columns = np.nonzero(labels == label)
        box = (int(columns.min()), int(rows.min()), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)
        logs = np.log([length[label] / side, contrast[label] / settings.low, length[label] / area[label]])
        found.append((box, np.array([1.0, *logs])))
    return found


def tune_settings(images: Sequence[LabelledImage]) -> tuple[RidgeFilterSettings, float]:
    """The settings of highest AP50 on ``images``, and that AP50; the weights of the score are fitted for each trial."""
    read = [(image, read_pixels(image.path)) for image in images]
    strong = {image.key: filter_photograph(pixels) for image, pixels in read if pixels is not None}
    best = (RidgeFilterSettings(), -1.0)
    for low, high, gap in product((1.8, 2.5, 4.0, 6.0), (1.5, 2.5, 4.0), (7, 11, 21)):
        settings = RidgeFilterSettings(low=low, high=low * high, gap_px=gap)
        found = {key: find_cracks(*one, settings) for key, one in strong.items()}
        settings = replace(settings, weights=_fit_weights(images, found))
        guesses = {key: _create_predictions(many, settings) for key, many in found.items()}
        precision = float(
            compute_average_precision(match_predictions(images, guesses, DefectClass.CRACK), thresholds=1)[0]
        )
        print(f"{precision:.3f}  {settings}", flush=True)
        if precision > best[1]:
            best = (settings, precision)
    return best


def _create_predictions(
    found: Sequence[tuple[Box, Float64Array]], settings: RidgeFilterSettings
) -> tuple[Prediction, ...]:
    return tuple(
        Prediction(box=box, score=compute_score(features, settings), defect_class=DefectClass.CRACK)
        for box, features in found
    )


def _fit_weights(
    images: Sequence[LabelledImage], found: Mapping[str, Sequence[tuple[Box, Float64Array]]]
) -> tuple[float, float, float, float]:
    """Weights by regularised logistic regression of hits on features; longer components are matched to truth first."""
    by_length = RidgeFilterSettings(weights=(0.0, 1.0, 0.0, 0.0))
    matches = match_predictions(
        images, {key: _create_predictions(many, by_length) for key, many in found.items()}, DefectClass.CRACK
    )
    places = zip(matches.image.tolist(), matches.rank.tolist(), strict=True)
    x = np.array([found[matches.images[i].key][rank][1] for i, rank in places])
    y = matches.hit[0].astype(np.float64)

    def compute_loss(weights: Float64Array) -> float:
        at = x @ weights
        return float((np.logaddexp(0, at) - y * at).sum() + 0.05 * (weights[1:] ** 2).sum())

    offset, length, contrast, slim = (round(float(value), 3) for value in minimize(compute_loss, np.zeros(4)).x)
    return offset, length, contrast, slim


def main() -> None:
    """Run the command line."""
    from benchmarks.detector_sets import open_crack_images

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["tune"])
    parser.add_argument("--every", type=int, default=8, help="use every n-th training photograph (of 607)")
    options = parser.parse_args()
    images = [*open_crack_images("train").images[:: options.every], *open_crack_images("val").images]
    settings, precision = tune_settings(images)
    print(f"best on {len(images)} photographs of training and validation sites: AP50 {precision:.3f}\n{settings}")


if __name__ == "__main__":
    main()
