"""Public first-order solvers: descent of scikit-learn, celer, glum and sortedl1, FISTA, and asgl.

Each stops at a tolerance of its own meaning: scikit-learn and celer by their duality gap relative
to the target, glum by its gradient, sortedl1 by its gap, group-lasso by the change of its
coefficients, asgl by the conic solver that it calls. The caller's certificate judges them all.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.solvers.peers import Kind, Part, Peer

TOLERANCE = 1e-8  # where none is asked for


@dataclass(frozen=True)
class ScikitDescent(Peer):
    """``enet_path`` of scikit-learn, coordinate descent, on X'X where samples are many.

    epochs: the most passes over the columns at a penalty.
    """

    name: ClassVar[str] = "scikit-learn-cd"
    package: ClassVar[str] = "sklearn"
    form: ClassVar[str] = "enet_path, coordinate descent on Z'Z, or on the rows where fewer"
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO", "elastic net")
    reads_sparse: ClassVar[bool] = True
    epochs: int = 100_000

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Each point from the last one; tolerance: of the gap over the target's square."""
        linear_model: Any = import_module("sklearn.linear_model")
        form: dict[str, Any] = {"precompute": False}
        if part.whole.tall:
            form = {"precompute": part.gram() * part.samples, "Xy": part.cross() * part.samples}
        found = []
        start = np.zeros(part.design.shape[1])
        # alpha (l1 + (1 - l1)/2 u^2) is f (1 + rho/2 u^2): both depend on f where rho is not 0.
        for fraction in part.fractions.tolist():
            total = fraction * (1.0 + part.ridge)
            _, coefficients, _ = linear_model.enet_path(
                part.design,
                part.target[:, 0],
                l1_ratio=1.0 / (1.0 + part.ridge),
                alphas=[total],
                coef_init=start,
                tol=tolerance or TOLERANCE,
                max_iter=self.epochs,
                check_input=False,
                **form,
            )
            start = coefficients[:, 0].copy()  # it works in place on what it is given
            found.append(start.copy())
        return np.stack(found)


@dataclass(frozen=True)
class Celer(Peer):
    """``celer_path`` (Massias, Gramfort and Salmon 2018).

    iterations: the most working sets at a penalty.
    """

    name: ClassVar[str] = "celer"
    package: ClassVar[str] = "celer"
    form: ClassVar[str] = "celer_path on the rows, or on the triangle of a QR where they are many"
    kinds: ClassVar[tuple[Kind, ...]] = (
        *("LASSO", "elastic net", "group-LASSO", "joint group-LASSO"),
    )
    reads_sparse: ClassVar[bool] = True
    iterations: int = 200

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: of its duality gap over the target's square."""
        package: Any = import_module("celer")
        rows, single = part.rows(), part.kind in ("LASSO", "elastic net")
        _, coefficients, *_ = package.celer_path(
            rows.design,
            rows.target,
            "lasso" if single else "grouplasso",
            alphas=part.fractions * (1.0 + part.ridge),
            l1_ratio=1.0 / (1.0 + part.ridge),
            groups=None if single else [block.tolist() for block in rows.blocks],
            max_iter=self.iterations,
            tol=tolerance or TOLERANCE,
        )
        found: Array = coefficients.T
        return found


@dataclass(frozen=True)
class Glum(Peer):
    """The IRLS with coordinate descent of glum (QuantCo), each point from the last one.

    iterations: the most quadratic approximations at a penalty.
    """

    name: ClassVar[str] = "glum"
    package: ClassVar[str] = "glum"
    form: ClassVar[str] = "GeneralizedLinearRegressor of the normal family, on the rows"
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO", "elastic net")
    reads_sparse: ClassVar[bool] = True
    iterations: int = 1000

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: of the norm of its minimum-norm subgradient."""
        package: Any = import_module("glum")
        rows = part.rows()
        model = package.GeneralizedLinearRegressor(
            l1_ratio=1.0 / (1.0 + part.ridge),
            fit_intercept=False,
            family="normal",
            solver="irls-cd",
            gradient_tol=tolerance or TOLERANCE,
            max_iter=self.iterations,
            warm_start=True,
            copy_X=False,
            check_input=False,
        )
        found = []
        for fraction in part.fractions.tolist():
            model.set_params(alpha=fraction * (1.0 + part.ridge))
            model.fit(rows.design, rows.target)
            found.append(np.array(model.coef_))
        return np.stack(found)


@dataclass(frozen=True)
class SortedL1(Peer):
    """``Slope.path`` of sortedl1 (Larsson et al. 2023), hybrid descent over clusters."""

    name: ClassVar[str] = "sortedl1"
    package: ClassVar[str] = "sortedl1"
    form: ClassVar[str] = "Slope.path on the rows, or on the triangle of a QR where they are many"
    kinds: ClassVar[tuple[Kind, ...]] = ("SLOPE", "LASSO")
    reads_sparse: ClassVar[bool] = True

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: of its relative duality gap."""
        package: Any = import_module("sortedl1")
        rows = part.rows()
        columns = rows.design.shape[1]
        lambdas = np.ones(columns) if part.lambdas is None else part.lambdas
        model = package.Slope(lam=lambdas, fit_intercept=False, tol=tolerance or TOLERANCE)
        path = model.path(
            rows.design,
            rows.target,
            alphas=part.fractions,
            tol_dev_change=0.0,  # the whole path, however little its last points explain
            tol_dev_ratio=1.0,
            max_clusters=columns + 1,
        )
        found: Array = np.asarray(path.coefs).reshape(columns, -1).T
        return found


@dataclass(frozen=True)
class Fista(Peer):
    """The FISTA of the package group-lasso (Moe 2020), each point from the last one.

    iterations: the most steps at a penalty.
    """

    name: ClassVar[str] = "group-lasso-fista"
    package: ClassVar[str] = "group_lasso"
    form: ClassVar[str] = "FISTA of the package group-lasso, on a QR where samples are many"
    kinds: ClassVar[tuple[Kind, ...]] = ("LASSO", "group-LASSO", "joint group-LASSO")
    iterations: int = 10_000

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """Tolerance: of the change of its coefficients."""
        package: Any = import_module("group_lasso")
        rows = part.rows()
        model = package.GroupLasso(
            groups=rows.groups,
            l1_reg=0.0,
            n_iter=self.iterations,
            tol=tolerance or TOLERANCE,
            scale_reg="none",
            fit_intercept=False,
            frobenius_lipschitz=True,
            warm_start=True,
            supress_warning=True,
        )
        found = []
        for fraction in part.fractions.tolist():
            # Version 1.5 steps along half its gradient and shrinks in full: what it solves has
            # twice the penalty that it is given.
            model.set_params(group_reg=0.5 * fraction)
            model.fit(rows.design, rows.target[:, None])
            found.append(np.asarray(model.coef_)[:, 0].copy())
        return np.stack(found)


@dataclass(frozen=True)
class Asgl(Peer):
    """The sparse-group LASSO of asgl (Mendez Civieta), which writes it by rows for cvxpy."""

    name: ClassVar[str] = "asgl"
    package: ClassVar[str] = "asgl"
    form: ClassVar[str] = "Regressor of penalisation asgl: cvxpy by rows, Clarabel"
    kinds: ClassVar[tuple[Kind, ...]] = ("sparse-group LASSO",)
    stops: ClassVar[bool] = False

    def solved(self, part: Part, tolerance: float | None) -> Array:
        """A problem per penalty; the tolerance is the conic solver's own."""
        package: Any = import_module("asgl")
        rows = part.rows()
        found = []
        for fraction in part.fractions.tolist():
            # It minimises |y - X u|^2/m + lambda1 (sum_j a_j |u_j| + sum_g b_g sqrt(c_g) |u_g|)/2,
            # c_g the size of the group.
            model = package.Regressor(
                penalization="asgl",
                fit_intercept=False,
                lambda1=4.0 * fraction,
                alpha=0.5,
                individual_weights=part.lambdas,
                group_weights=1.0 / np.sqrt([len(block) for block in rows.blocks]),
                tol=0.0,
            )
            model.fit(rows.design, rows.target, group_index=rows.groups + 1)
            found.append(np.asarray(model.coef_).ravel().copy())
        return np.stack(found)
