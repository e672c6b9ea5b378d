"""The verdict of a second look: a rule whose limits are stated here, and in docs/history.md with what they rest on."""

from __future__ import annotations

import numpy as np

from facadelake.tracking.second_look.comparison import ALIKE_MIN, Comparison
from schemas.vocabulary import DefectClass, LookVerdict

_CELLS_MIN = 8  # along the defect, with one cell beyond it at each end; fewer show nothing of its look
_RECOGNISED_MIN = 0.4  # similarity of the surroundings from which it is the same wall
_GONE_MAX = 0.7
_GONE_DIFFERENCE_MIN, _GONE_LEFT_MAX = 0.5, 0.4
_FADED_MIN, _FADED_SIGMAS_MIN = 0.3, 7.0  # unchanged places reach 6.5 sigma
_OPPOSITE_MAX = 1.3  # of the change away from the wall, over that towards it: beyond it, something grew
_THIN_FADED_MIN, _THIN_FADED_SIGMAS_MIN = 0.4, 12.0
_DARKER_SIGMAS_MIN, _FADED_MIN_BESIDE_DARKER = 4.5, 0.5
_NOT_SAME_FADED_MIN, _NOT_SAME_SIGMAS_MIN = 0.35, 10.0
_HIDDEN_AROUND_MAX, _HIDDEN_MAX = 0.3, 0.5


def judge_comparison(found: Comparison, defect_class: DefectClass) -> LookVerdict:
    """The verdict of a comparison; where the evidence is for neither, ``undecided``.

    A defect is gone where the wall is recognised, its look is not, and it faded into the wall more than anything
    darkened. Of a crack on a structured wall the look is the wall's: there, that a line of its length faded, far beyond
    the noise, is enough.
    """
    if np.isnan(found.at_defect) or found.cells < _CELLS_MIN:
        return LookVerdict.UNDECIDED
    fading, around = found.fading, float(np.nan_to_num(found.around, nan=0.0))
    if found.at_defect >= ALIKE_MIN and not (
        fading.extent >= _NOT_SAME_FADED_MIN and fading.sigmas >= _NOT_SAME_SIGMAS_MIN
    ):
        return LookVerdict.SAME
    if around >= _RECOGNISED_MIN and _has_gone(found, defect_class):
        return LookVerdict.GONE
    if around < _HIDDEN_AROUND_MAX and found.at_defect < _HIDDEN_MAX:
        return LookVerdict.HIDDEN
    return LookVerdict.UNDECIDED


def _has_gone(found: Comparison, defect_class: DefectClass) -> bool:
    """Whether the defect faded, on a wall that is recognised."""
    fading = found.fading
    if fading.opposite_extent > _OPPOSITE_MAX * fading.extent:
        return False
    if found.at_defect < _GONE_MAX and fading.extent >= _FADED_MIN and fading.sigmas >= _FADED_SIGMAS_MIN:
        clear = found.difference >= _GONE_DIFFERENCE_MIN or found.left < _GONE_LEFT_MAX
        return clear or fading.extent >= _THIN_FADED_MIN
    # A crack that grew may have another line; of one that is gone nothing is darker, or most of it has faded.
    extent_min = _FADED_MIN_BESIDE_DARKER if fading.opposite_sigmas >= _DARKER_SIGMAS_MIN else _THIN_FADED_MIN
    return (
        defect_class is DefectClass.CRACK
        and fading.extent >= extent_min
        and fading.sigmas >= max(_THIN_FADED_SIGMAS_MIN, fading.opposite_sigmas)
    )
