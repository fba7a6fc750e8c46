"""Array types that modules share."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""Double precision, any shape; docstrings give the shapes."""

np.empty(2**19)
"""Freed at once. Until a block of its size was freed, the allocator of glibc gives memory back whenever an array is
freed, and temporary arrays of 100 kB fault their pages in again and again: what is computed in blocks takes up to twice
as long."""
