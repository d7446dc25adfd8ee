"""Public homotopy solvers of the LASSO: LARS of scikit-learn and of SPAMS.

Both return the breakpoints of the path; between two of them the solution is linear in the penalty.
Source: Efron, Hastie, Johnstone and Tibshirani, Ann. Statist. 32 (2004) 407-499.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.solvers.peers import Kind, Part, Peer


@dataclass(frozen=True)
class ScikitLars(Peer):
    """``lars_path_gram`` of scikit-learn on X'X where samples are many, else ``lars_path`` on X.

    steps: the most events of the path, per column.
    """

    name: ClassVar[str] = "scikit-learn-lars"
    package: ClassVar[str] = "sklearn"
    form: ClassVar[str] = "lars_path_gram on Z'Z, or lars_path on the rows where they are fewer"
    stops: ClassVar[bool] = False
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO",)
    steps: int = 10

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Interpolated between the breakpoints; there is no tolerance to set."""
        linear_model: Any = import_module("sklearn.linear_model")
        shared = {
            "method": "lasso",
            "alpha_min": float(part.fractions[-1]),
            "max_iter": self.steps * part.design.shape[1],
        }
        if part.whole.tall:
            knots, _, coefficients = linear_model.lars_path_gram(
                part.cross() * part.samples,
                part.gram() * part.samples,
                n_samples=part.samples,
                copy_Gram=False,
                **shared,
            )
        else:
            knots, _, coefficients = linear_model.lars_path(
                part.design, part.target[:, 0], Gram=None, **shared
            )
        return interpolated(knots, coefficients, part.fractions).T


@dataclass(frozen=True)
class Spams(Peer):
    """``spams.lasso`` with its regularisation path, on Q = X'X/m where samples are many.

    steps: the most events of the path, per column.
    """

    name: ClassVar[str] = "spams"
    package: ClassVar[str] = "spams"
    extra: ClassVar[str] = "spams-bin"
    form: ClassVar[str] = "lasso (LARS) on Z'Z, or on the rows where they are fewer"
    stops: ClassVar[bool] = False
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO",)
    steps: int = 10

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Interpolated between the breakpoints; there is no tolerance to set."""
        spams: Any = import_module("spams")
        root, columns = np.sqrt(part.samples), part.design.shape[1]
        target = np.asfortranarray(part.target[:, :1] / root)
        cross = np.asfortranarray(part.cross()[:, None])
        if part.whole.tall:
            gram = np.asfortranarray(part.gram())
            data = {"Q": gram, "q": cross}
        else:
            gram, data = None, {"D": np.asfortranarray(part.design / root)}
        _, steps = spams.lasso(
            target,
            **data,
            return_reg_path=True,
            lambda1=float(part.fractions[-1]),
            mode=spams.PENALTY,
            max_length_path=self.steps * min(part.samples, columns),
            numThreads=1,
        )
        coefficients = np.hstack([np.zeros((columns, 1)), np.asarray(steps)])
        # It returns the breakpoints without their penalties: the largest correlation there is one.
        if gram is not None:
            correlation = cross - gram @ coefficients
        else:
            correlation = data["D"].T @ (target - data["D"] @ coefficients)
        knots = np.minimum.accumulate(np.abs(correlation).max(axis=0))
        return interpolated(knots, coefficients, part.fractions).T


def interpolated(knots: Array, coefficients: Array, alphas: Array) -> Array:
    """A piecewise linear path at alphas (p,): knots (b,) descending, coefficients (k, b) -> (k, p).

    Below the last knot, where a path broke off, its last coefficients are all there is.
    """
    if len(knots) == 1:
        return np.repeat(coefficients, len(alphas), axis=1)
    alphas = np.clip(alphas, knots[-1], knots[0])
    upper = np.clip(np.searchsorted(-knots, -alphas, side="left"), 1, len(knots) - 1)
    width = knots[upper - 1] - knots[upper]
    share = np.where(width > 0, (knots[upper - 1] - alphas) / np.where(width > 0, width, 1.0), 1.0)
    between: Array = coefficients[:, upper - 1] * (1 - share) + coefficients[:, upper] * share
    return between
