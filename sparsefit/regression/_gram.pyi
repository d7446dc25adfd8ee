"""Gram matrices, compiled: `sparsefit.regression.statistics` is the front door."""

from numpy import float64
from numpy.typing import NDArray

def supported() -> bool:
    """Whether this CPU has AVX-512."""

def products(
    theta: NDArray[float64],
    target: NDArray[float64],
    gram: NDArray[float64],
    cross: NDArray[float64],
    square: NDArray[float64],
    /,
) -> None:
    """Z'Z (k, k), Z'Y (k, n) and |y_t|^2 (n,) of theta (m, k) and target (m, n)."""
