"""skglm (Bertrand et al. 2022): descent with Anderson acceleration on working sets.

Its tolerance is the largest violation of its optimality conditions; targets are in units of the
largest penalty, so that the violation is relative to that.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.solvers.peers import Kind, Part, Peer, Rows

TOLERANCE = 1e-8  # where none is asked for


@dataclass(frozen=True)
class Skglm(Peer):
    """AndersonCD, GroupBCD or FISTA of skglm, each point from the last one.

    iterations: the most working sets (steps of FISTA) at a penalty; epochs: the most passes over
    one of them.
    """

    name: ClassVar[str] = "skglm"
    package: ClassVar[str] = "skglm"
    form: ClassVar[str] = "AndersonCD, GroupBCD or FISTA on the rows, or on a QR where many"
    kinds: ClassVar[tuple[Kind, ...]] = (
        *("LASSO", "elastic net", "group-LASSO", "joint group-LASSO", "sparse-group LASSO"),
        "SLOPE",
    )
    reads_sparse: ClassVar[bool] = True
    iterations: int = 1000
    epochs: int = 50_000

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: of the violation of its optimality conditions, in the largest penalty."""
        rows, stop = part.rows(), tolerance or TOLERANCE
        solvers, datafits = import_module("skglm.solvers"), import_module("skglm.datafits")
        if part.kind in ("LASSO", "elastic net"):
            solver: Any = solvers.AndersonCD(
                max_iter=self.iterations, max_epochs=self.epochs, tol=stop, fit_intercept=False,
                warm_start=True,
            )  # fmt: skip
            datafit = datafits.Quadratic()
        elif part.kind == "SLOPE":
            solver = solvers.FISTA(
                max_iter=100 * self.iterations, tol=stop, opt_strategy="fixpoint"
            )
            datafit = datafits.Quadratic()
        else:
            solver = solvers.GroupBCD(
                max_iter=self.iterations,
                max_epochs=self.epochs,
                tol=stop,
                warm_start=True,
                ws_strategy="subdiff" if part.lambdas is None else "fixpoint",
            )
            order, starts = _layout(rows)
            datafit = datafits.QuadraticGroup(starts, order)
        return self._along(part, rows, solver, _jitted(datafit))

    def _along(self, part: Part, rows: Rows, solver: Any, datafit: Any) -> Array:
        weights, fitted = np.zeros(rows.design.shape[1]), np.zeros(len(rows.target))
        penalty, found = None, []
        for fraction in part.fractions.tolist():
            if penalty is None or part.kind in ("elastic net", "SLOPE"):
                penalty = self._penalty(part, rows, fraction)
            penalty.alpha = fraction * (1.0 + part.ridge)
            weights = solver.solve(
                rows.design, rows.target, datafit, penalty, weights.copy(), fitted
            )[0]
            fitted = rows.design @ weights
            found.append(weights)
        return np.stack(found)

    def _penalty(self, part: Part, rows: Rows, fraction: float) -> Any:
        penalties: Any = import_module("skglm.penalties")
        if part.kind == "LASSO":
            return _jitted(penalties.L1(fraction))
        if part.kind == "elastic net":
            return _jitted(
                penalties.L1_plus_L2(fraction * (1.0 + part.ridge), 1.0 / (1.0 + part.ridge))
            )
        if part.kind == "SLOPE":
            return _jitted(penalties.SLOPE(part.lambdas, fraction))
        order, starts = _layout(rows)
        ones = np.ones(len(starts) - 1)
        if part.lambdas is None:
            return _jitted(penalties.WeightedGroupL2(fraction, ones, starts, order))
        return _jitted(penalties.WeightedL1GroupL2(fraction, ones, part.lambdas, starts, order))


def _layout(rows: Rows) -> tuple[Array, Array]:
    """The coefficients in the order of their groups, and where each group starts, as int32."""
    blocks = rows.blocks
    starts = np.concatenate([[0], np.cumsum([len(block) for block in blocks])])
    return np.concatenate(blocks).astype(np.int32), starts.astype(np.int32)


def _jitted(part: Any) -> Any:
    return import_module("skglm.utils.jit_compilation").compiled_clone(part)
