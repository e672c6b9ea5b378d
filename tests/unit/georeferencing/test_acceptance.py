"""A campaign that is not accurate enough is refused."""

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.acceptance import require_accuracy
from schemas.vocabulary import ControlKind

GOOD = np.array([0.02, 0.03, 0.05])


def test_a_placement_not_known_well_enough_is_refused() -> None:
    message = (
        r"placed by gps, .* known to 0\.62 m up \(one sigma\), the limit is 0\.5 m .*placement_sigma_max_m\); do so"
    )
    with pytest.raises(GeoreferenceError, match=message):
        require_accuracy(
            control=ControlKind.GPS, sigma_m=np.array([0.1, 0.2, 0.62]), limit_m=0.5, held_out_m=np.zeros(0),
            remedy="do so",
        )  # fmt: skip
    with pytest.raises(GeoreferenceError, match=r"known to 0\.70 m east"):
        require_accuracy(
            control=ControlKind.MODEL, sigma_m=np.array([0.7, 0.1, 0.1]), limit_m=0.5, held_out_m=np.zeros(0), remedy=""
        )
    require_accuracy(control=ControlKind.GCP, sigma_m=GOOD, limit_m=0.5, held_out_m=np.zeros(0), remedy="")


def test_held_out_points_that_lie_elsewhere_are_refused() -> None:
    far = np.array([1.8, 1.7, 0.02])
    with pytest.raises(
        GeoreferenceError, match=r"lie 1\.70 m \(median\) .* the limit is 1\.5 m .* coordinates, CRS and"
    ):
        require_accuracy(control=ControlKind.GCP, sigma_m=GOOD, limit_m=0.5, held_out_m=far, remedy="")
    one_bad = np.array([9.0, 0.02, 0.03])  # one wrong point is no reason: it is named in the table
    require_accuracy(control=ControlKind.GCP, sigma_m=GOOD, limit_m=0.5, held_out_m=one_bad, remedy="")
