"""The compiled group-LASSO path; see variational_compiled.py."""

from typing import Any

def check(blas: Any, lapack: Any) -> None: ...
def path(
    blas: Any,
    lapack: Any,
    gram: Any,
    cross: Any,
    starts: Any,
    alphas: Any,
    tolerance: float,
    weights: Any,
    iterations: Any,
    gaps: Any,
) -> None: ...
