"""The arrays that the package's signatures speak of, named once."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.intp]  # indices, labels


def local_maxima(curve: Array) -> IntArray:
    """Indices of the local maxima of a curve (q,), its ends included, highest first."""
    padded = np.concatenate([[-np.inf], curve, [-np.inf]])
    tops = np.flatnonzero((curve >= padded[:-2]) & (curve >= padded[2:]))
    return tops[np.argsort(-curve[tops], kind="stable")]
