"""Z'Z, Z'Y and |y_t|^2 of a block of rows: compiled where the CPU has AVX-512, else by numpy.

Both sum the same products in double precision, in another order; the choice depends on the
machine alone, never on the data.
"""

from functools import cache
from importlib import import_module
from typing import Literal

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.objective import block_products

_KERNEL = "sparsefit.regression._gram"  # compiled; absent where there was no compiler


@cache
def product_loop() -> Literal["compiled", "numpy"]:
    """Which one runs here."""
    try:
        _gram = import_module(_KERNEL)
    except ImportError:  # not built: no compiler
        return "numpy"
    return "compiled" if _gram.supported() else "numpy"


def products(theta: Array, target: Array) -> tuple[Array, Array, Array]:
    """Z'Z (k, k), Z'Y (k, n) and |y_t|^2 (n,) of theta (m, k) and target (m, n)."""
    if product_loop() == "numpy":
        return block_products(theta, target)
    _gram = import_module(_KERNEL)

    k, n = theta.shape[1], target.shape[1]
    gram, cross, square = np.empty((k, k)), np.empty((k, n)), np.empty(n)
    rows, values = (np.ascontiguousarray(part, dtype=np.float64) for part in (theta, target))
    _gram.products(rows, values, gram, cross, square)
    return gram, cross, square
