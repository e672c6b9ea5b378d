"""Similarity of two depth images of one view: SSIM and differences where both show a surface.

Eq. 12 of the paper has a ``+`` between the two factors of SSIM; it is a product (Wang et al. 2004, IEEE TIP 13(4)):
``(2 mu_i mu_j + C1)(2 sigma_ij + C2) / ((mu_i^2 + mu_j^2 + C1)(sigma_i^2 + sigma_j^2 + C2))``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion
from skimage.metrics import structural_similarity

from facadelake.core.arrays import BoolArray, Float64Array

SIGMA_PX = 1.5
WINDOW_PX = 11  # support of scikit-image's Gaussian of 1.5 px


@dataclass(frozen=True, kw_only=True)
class DepthComparison:
    """Result of a comparison.

    ``ssim`` is the mean over the pixels whose window is complete in both images; ``windows`` is their number.
    ``compared_share`` is the share of the model's pixels that the as-built surface covers. Differences are as-built
    minus model, in metres along the z axis of the camera; the 95th percentile is that of their absolute values. SSIM
    and differences are NaN where there are no pixels to compare.
    """

    ssim: float
    windows: int
    compared_share: float
    difference_median_m: float
    difference_p95_m: float


def compare_depth(model_depth_m: Float64Array, as_built_depth_m: Float64Array) -> DepthComparison:
    """Compare two depth images (h, w) of one view, metres; pixels without a surface are not finite."""
    model, as_built = np.isfinite(model_depth_m), np.isfinite(as_built_depth_m)
    both = model & as_built
    share = float(both.sum() / model.sum()) if model.any() else 0.0
    if not both.any():
        return DepthComparison(
            ssim=np.nan, windows=0, compared_share=share, difference_median_m=np.nan, difference_p95_m=np.nan
        )
    difference = as_built_depth_m[both] - model_depth_m[both]
    complete: BoolArray = binary_erosion(both, np.ones((WINDOW_PX, WINDOW_PX)))
    return DepthComparison(
        ssim=_compute_masked_ssim(model_depth_m, as_built_depth_m, both, complete),
        windows=int(complete.sum()),
        compared_share=share,
        difference_median_m=float(np.median(difference)),
        difference_p95_m=float(np.percentile(np.abs(difference), 95)),
    )


def _compute_masked_ssim(a: Float64Array, b: Float64Array, both: BoolArray, complete: BoolArray) -> float:
    """Mean SSIM over the pixels ``complete``; fill values of other pixels are outside their windows."""
    if not complete.any():
        return float("nan")
    low = min(a[both].min(), b[both].min())
    data_range = max(a[both].max(), b[both].max()) - low
    if data_range == 0:
        return 1.0  # both are the same plane, perpendicular to the viewing axis
    # C1 depends on the origin: depths are relative to the nearest surface, as in an image stretched to its range.
    filled = [np.where(both, image - low, 0.0) for image in (a, b)]
    _, similarity = structural_similarity(
        *filled,
        data_range=data_range,
        gaussian_weights=True,
        sigma=SIGMA_PX,
        use_sample_covariance=False,
        full=True,
    )
    return float(similarity[complete].mean())
