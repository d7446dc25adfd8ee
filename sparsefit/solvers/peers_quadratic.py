"""The LASSO by solvers of quadratic programs on its dual, set up once for the whole path:

    minimise over r:   1/2 |r|^2 - y'r   subject to   |X'r| <= f m   (each entry)

in the notation of `peers`, f the penalty fraction. r is the residual, strictly convex whatever X
is, and the multipliers of the constraints are the coefficients u, as r = y - X u. Along the path
only the bounds move.

Sources: OSQP, Stellato et al. (2020); PIQP, Schwan et al. (2023); DAQP, Arnstrom et al. (2022).
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array
from sparsefit.solvers.peers import Kind, Part, Peer

TOLERANCE = 1e-9  # where none is asked for


@dataclass(frozen=True)
class OsqpDual(Peer):
    """OSQP, with polishing. steps: its most iterations at a penalty."""

    name: ClassVar[str] = "osqp-direct"
    package: ClassVar[str] = "osqp"
    extra: ClassVar[str] = "osqp"
    form: ClassVar[str] = "OSQP itself on the dual in the rows, its bounds moved along"
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO",)
    reads_sparse: ClassVar[bool] = True
    steps: int = 50_000

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: absolute and relative."""
        package: Any = import_module("osqp")
        rows = part.rows()
        bounds = _bounds(part, len(rows.target), rows.design.shape[1])
        solver = package.OSQP()
        solver.setup(
            P=sparse.eye_array(len(rows.target), format="csc"),
            q=-rows.target,
            A=sparse.csc_matrix(rows.design.T),
            l=-bounds[0],
            u=bounds[0],
            eps_abs=tolerance or TOLERANCE,
            eps_rel=tolerance or TOLERANCE,
            max_iter=self.steps,
            polishing=True,
            verbose=False,
        )
        found, reach = [], np.abs(rows.design.T @ rows.target)
        for bound in bounds:
            if np.all(reach <= bound):  # u = 0: OSQP prints a line there, whatever it is told
                found.append(np.zeros(len(bound)))
                continue
            solver.update(l=-bound, u=bound)
            found.append(np.asarray(solver.solve(raise_error=False).y, dtype=float))
        return np.stack(found)


@dataclass(frozen=True)
class PiqpDual(Peer):
    """PIQP's dense interior point. steps: its most iterations at a penalty."""

    name: ClassVar[str] = "piqp-direct"
    package: ClassVar[str] = "piqp"
    form: ClassVar[str] = "PIQP itself on the dual in the rows, its bounds moved along"
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO",)
    steps: int = 250

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: absolute and relative, of residuals and gap."""
        package: Any = import_module("piqp")
        rows, stop = part.rows(), tolerance or TOLERANCE
        bounds = _bounds(part, len(rows.target), rows.design.shape[1])
        solver = package.DenseSolver()
        settings = solver.settings
        settings.eps_abs = settings.eps_rel = stop
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = stop
        settings.max_iter = self.steps
        constraint = np.asfortranarray(rows.design.T)
        solver.setup(
            np.eye(len(rows.target), order="F"), -rows.target, None, None, constraint,
            -bounds[0], bounds[0],
        )  # fmt: skip
        found = []
        for bound in bounds:
            solver.update(h_l=-bound, h_u=bound)
            solver.solve()
            found.append(np.array(solver.result.z_u) - np.array(solver.result.z_l))
        return np.stack(found)


@dataclass(frozen=True)
class DaqpDual(Peer):
    """DAQP's dual active set. steps: its most iterations at a penalty."""

    name: ClassVar[str] = "daqp-direct"
    package: ClassVar[str] = "daqp"
    form: ClassVar[str] = "DAQP itself on the dual in the rows"
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO",)
    steps: int = 100_000

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: of the constraints, in units of the largest penalty."""
        package: Any = import_module("daqp")
        rows = part.rows()
        hessian = np.eye(len(rows.target))
        constraint = np.ascontiguousarray(rows.design.T)
        found = []
        for bound in _bounds(part, len(rows.target), rows.design.shape[1]):
            stop = (tolerance or TOLERANCE) * len(rows.target)
            _, _, _, info = package.solve(
                hessian, -rows.target, constraint, bound, -bound,
                primal_tol=stop, iter_limit=self.steps,
            )  # fmt: skip
            found.append(np.array(info["lam"], dtype=float))
        return np.stack(found)


def _bounds(part: Part, rows: int, columns: int) -> Array:
    """f m (p, k) in the rows that are handed over."""
    return np.multiply.outer(part.fractions * rows, np.ones(columns))
