"""What is known of a photograph before a detector looks at it: how fine it shows the facade, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """``gsd_mm``: millimetres on the facade a pixel of the photograph, None where unknown.

    ``target``: a mask of any size that lies over the whole photograph, true where the building is; None: it may be
    anywhere. ``remark`` says what is not known and why, for the rows of what is found.
    """

    gsd_mm: float | None = None
    target: NDArray[np.bool_] | None = None
    remark: str = ""
