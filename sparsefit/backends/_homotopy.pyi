"""The LASSO path, compiled: `homotopy.lasso_path` is its front door."""

from numpy import bool_, float64
from numpy.typing import NDArray

def path(
    gram: NDArray[float64],
    cross: NDArray[float64],
    alphas: NDArray[float64],
    weights: NDArray[float64],
    complete: NDArray[bool_],
    /,
) -> int:
    """Fill weights (p, k) and complete (p,), given as zeros; returns the steps taken."""
