"""Array types that modules share."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""Double precision, any shape; docstrings give the shapes."""
