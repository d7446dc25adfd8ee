"""The LASSO by OSQP itself (Stellato et al. 2020) on its dual, set up once for the whole path.

    minimise over x:   1/2 x'G x   subject to   c - f <= G x <= c + f

in the notation of `peer_forms`, f the penalty fraction. Its multipliers y obey G x + G y = 0 and
have the signs of the LASSO's solution where its correlation reaches f: that solution is u = -y.
Along the path only the bounds move, and each point starts from the last.
"""

from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.peer_forms import Part

TOLERANCE = 1e-9
STEPS = 50_000


def osqp_dual(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """With polishing; tolerance: absolute and relative."""
    import osqp
    from scipy import sparse

    gram, cross = part.gram, part.cross
    matrix = sparse.csc_matrix(gram)
    solver: Any = osqp.OSQP()
    solver.setup(
        P=sparse.triu(matrix, format="csc"),
        q=np.zeros(len(cross)),
        A=matrix,
        l=cross - fractions[0],
        u=cross + fractions[0],
        eps_abs=tolerance or TOLERANCE,
        eps_rel=tolerance or TOLERANCE,
        max_iter=STEPS,
        polishing=True,
        verbose=False,
    )
    found = []
    for fraction in fractions.tolist():
        if np.all(np.abs(cross) <= fraction):  # x = 0: OSQP prints a line, whatever it is told
            found.append(np.zeros(len(cross)))
            continue
        solver.update(l=cross - fraction, u=cross + fraction)
        found.append(-np.asarray(solver.solve(raise_error=False).y, dtype=float))
    return np.stack(found)
