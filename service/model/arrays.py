"""Types of arrays; shapes and units are told where an array is taken or returned."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int_]
