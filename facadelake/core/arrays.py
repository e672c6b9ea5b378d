"""Types of arrays: the name states the element type and, where it is fixed, the shape.

``Float64Nx3`` is (n, 3). NumPy's types cannot express shapes: a type checker sees the element type alone, the shape is
documentation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
Float64N = NDArray[np.float64]
Float64Nx2 = NDArray[np.float64]
Float64Nx3 = NDArray[np.float64]
Float64Nx4 = NDArray[np.float64]
Float64Nx3x3 = NDArray[np.float64]
Float64Nx6x6 = NDArray[np.float64]
Float64x2 = NDArray[np.float64]
Float64x3 = NDArray[np.float64]
Float64x3x3 = NDArray[np.float64]
Float64x4x4 = NDArray[np.float64]
Float64x6x6 = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Float32Nx4 = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
Int64Array = NDArray[np.int64]
Int64Nx3 = NDArray[np.int64]
UInt8Array = NDArray[np.uint8]
# Positions in the first axis of other arrays, or rows of a table.
RowIndices = NDArray[np.int64]
# (h, w, 3) in OpenCV's order blue, green, red, or (h, w) grey.
UInt8Image = NDArray[np.uint8]
