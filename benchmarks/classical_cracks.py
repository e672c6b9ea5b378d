"""A crack filter of the classical kind, to compare detectors with: dark ridges at several scales, linked, boxed.

    .venv/bin/python -m benchmarks.classical_cracks tune     # prints the best setting on the training sites

Ridges by the Hessian's eigenvalues (Frangi et al., MICCAI 1998; dark lines alone), in units of the picture's own
texture, hysteresis (Canny 1986), near pieces linked. A component's score is logistic in its length, contrast and
slimness. Setting and score were chosen on training and validation sites alone, never on test sites.
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
from numpy.typing import NDArray
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

_SIDE_PX = 640  # larger pictures are shrunk to it: finer texture than cracks drowns them
_SCALES_PX = (1.5, 2.5, 4.0)
_FLAT_PX = 20.0  # light and stains wider than this are taken out


@dataclass(frozen=True, kw_only=True)
class Setting:
    """``low`` and ``high`` thresholds in units of the texture's median, ``gap_px`` over which pieces are linked,
    ``least`` length of a component as a share of the picture's side; ``weights`` of the score: offset, log of length
    as a share of the side, log of contrast over ``low``, log of length over area."""

    low: float = 4.0
    high: float = 9.0
    gap_px: int = 9
    least: float = 0.1
    weights: tuple[float, float, float, float] = (0.0, 1.0, 1.0, 0.0)


# The best of 15 settings on 137 pictures of training and validation sites (AP50 0.289), by ``tune``.
TUNED = Setting(low=2.5, high=6.25, gap_px=7, least=0.1, weights=(-6.803, 1.917, -0.823, -4.085))


class ClassicalCracks:
    """Finds cracks and nothing else."""

    name = "classical ridge filter"

    def __init__(self, setting: Setting = TUNED, threshold: float = 0.5) -> None:
        self._setting = setting
        self.threshold = threshold
        self.sha256 = hashlib.sha256(json.dumps(asdict(setting)).encode()).hexdigest()

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions:
        """Boxes of all components."""
        strength, gain = strengths(pixels_bgr)
        found = tuple(
            DetectedBox(box=box, score=probability(features, self._setting), class_name=str(DefectClass.CRACK))
            for box, features in pieces(strength, gain, self._setting)
        )
        return ImagePredictions(
            above_floor=found, above_threshold=tuple(one for one in found if one.score >= self.threshold)
        )


def strengths(pixels_bgr: UInt8Image) -> tuple[Float64Array, float]:
    """``ridges`` of a photograph, shrunk where it is large, and pixels of the shrunk one for each of its own."""
    gain = min(1.0, _SIDE_PX / max(pixels_bgr.shape[:2]))
    grey = cv2.cvtColor(pixels_bgr, cv2.COLOR_BGR2GRAY)
    if gain < 1:
        grey = cv2.resize(grey, None, fx=gain, fy=gain, interpolation=cv2.INTER_AREA)
    return ridges(np.asarray(grey, dtype=np.uint8)), gain


def pieces(strength: Float64Array, gain: float, setting: Setting) -> list[tuple[Box, Float64Array]]:
    """Boxes in pixels of the photograph, and features (4,), of the components."""
    return [
        (Box(x_px=x / gain, y_px=y / gain, width_px=w / gain, height_px=h / gain), features)
        for (x, y, w, h), features in components(strength, setting)
    ]


def probability(features: Float64Array, setting: Setting) -> float:
    """The score of a component."""
    return float(1 / (1 + np.exp(-features @ np.array(setting.weights))))


def ridges(grey: NDArray[np.uint8]) -> Float64Array:
    """How much each pixel lies on a dark line, in units of the median over the picture."""
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


def components(strength: Float64Array, setting: Setting) -> list[tuple[tuple[int, int, int, int], Float64Array]]:
    """Box (left, top, width, height) and features (4,) of every linked piece that is long enough."""
    lines = apply_hysteresis_threshold(strength, setting.low, setting.high)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (setting.gap_px, setting.gap_px))
    linked = cv2.dilate(lines.astype(np.uint8), reach)
    count, labels, _, _ = cv2.connectedComponentsWithStats(linked, connectivity=8)
    labels = np.where(lines, labels, 0)
    thin = np.where(skeletonize(lines), labels, 0)
    area = np.bincount(labels.ravel(), minlength=count)
    length = np.bincount(thin.ravel(), minlength=count)
    contrast = np.bincount(labels.ravel(), weights=strength.ravel(), minlength=count) / np.maximum(area, 1)
    side = max(strength.shape)
    found = []
    for label in np.flatnonzero(length >= setting.least * side).tolist():
        if label == 0:
            continue
        rows, columns = np.nonzero(labels == label)
        box = (int(columns.min()), int(rows.min()), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)
        logs = np.log([length[label] / side, contrast[label] / setting.low, length[label] / area[label]])
        found.append((box, np.array([1.0, *logs])))
    return found


def tuned(images: Sequence[LabelledImage]) -> tuple[Setting, float]:
    """The setting of highest AP50 on ``images`` and that AP50; each setting's score is fitted to its own hits."""
    read = [(image, read_pixels(image.path)) for image in images]
    strong = {image.key: strengths(pixels) for image, pixels in read if pixels is not None}
    best = (Setting(), -1.0)
    for low, high, gap in product((1.8, 2.5, 4.0, 6.0), (1.5, 2.5, 4.0), (7, 11, 21)):
        setting = Setting(low=low, high=low * high, gap_px=gap)
        found = {key: pieces(*one, setting) for key, one in strong.items()}
        setting = replace(setting, weights=_fitted(images, found))
        guesses = {key: _predictions(many, setting) for key, many in found.items()}
        precision = float(
            compute_average_precision(match_predictions(images, guesses, DefectClass.CRACK), thresholds=1)[0]
        )
        print(f"{precision:.3f}  {setting}", flush=True)
        if precision > best[1]:
            best = (setting, precision)
    return best


def _predictions(found: Sequence[tuple[Box, Float64Array]], setting: Setting) -> tuple[Prediction, ...]:
    return tuple(
        Prediction(box=box, score=probability(features, setting), defect_class=DefectClass.CRACK)
        for box, features in found
    )


def _fitted(
    images: Sequence[LabelledImage], found: Mapping[str, Sequence[tuple[Box, Float64Array]]]
) -> tuple[float, float, float, float]:
    """Logistic regression of hits on features, held to small weights; the longest piece takes a truth."""
    by_length = Setting(weights=(0.0, 1.0, 0.0, 0.0))
    matches = match_predictions(
        images, {key: _predictions(many, by_length) for key, many in found.items()}, DefectClass.CRACK
    )
    places = zip(matches.image.tolist(), matches.rank.tolist(), strict=True)
    x = np.array([found[matches.images[i].key][rank][1] for i, rank in places])
    y = matches.hit[0].astype(np.float64)

    def loss(weights: Float64Array) -> float:
        at = x @ weights
        return float((np.logaddexp(0, at) - y * at).sum() + 0.05 * (weights[1:] ** 2).sum())

    offset, length, contrast, slim = (round(float(value), 3) for value in minimize(loss, np.zeros(4)).x)
    return offset, length, contrast, slim


def main() -> None:
    """Command line."""
    from benchmarks.detector_sets import crack_images

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["tune"])
    parser.add_argument("--every", type=int, default=8, help="take every n-th training picture (of 607)")
    options = parser.parse_args()
    images = [*crack_images("train").images[:: options.every], *crack_images("val").images]
    setting, precision = tuned(images)
    print(f"best on {len(images)} pictures of training and validation sites: AP50 {precision:.3f}\n{setting}")


if __name__ == "__main__":
    main()
