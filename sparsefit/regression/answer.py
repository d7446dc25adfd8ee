"""The results of `fit` and `path`: weights with the certificate that the caller computed."""

import html
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array, Brief, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, is_real, shown
from sparsefit.regression.backend import Backend, PenalisedBackend, settings_of
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.problem import RegressionProblem, real_matrix

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Brief):
    """The weights of a back-end on one problem, with their certificate.

    weights: (k, n) in the original units of theta, all NaN where there is no solution.
    status: ``ok``; ``inaccurate`` where the certificate plus its rounding bound exceeds the
    tolerance; ``unidentifiable``; or ``error``. reason: the cause of any status but ``ok``.
    seconds: wall time of the solve. repaired: whether the certificate rejected the exact path's
    weights and these are the referee's. criterion: (30,), the values compared to choose an
    alpha_fraction of "auto", from alpha_fraction 1 to 1e-3; None otherwise.
    """

    weights: Array
    status: str
    reason: str
    certificate: Certificate | None
    seconds: float
    backend: Backend
    solver_status: str = ""
    iterations: int | None = None
    repaired: bool = False
    criterion: Array | None = field(default=None, repr=False, kw_only=True)
    problem: RegressionProblem = field(repr=False, kw_only=True)

    @property
    def alpha_fraction(self) -> float:
        """The penalty as a fraction of alpha_max; NaN of a back-end without one."""
        value = getattr(self.backend, "alpha_fraction", None)
        return float(value) if is_real(value) else math.nan

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the back-end, JSON-ready."""
        return settings_of(self.backend)

    @property
    def alpha(self) -> float:
        """The penalty in the unit of the target, alpha_fraction * alpha_max; NaN without one."""
        if math.isnan(self.alpha_fraction) or not isinstance(self.backend, PenalisedBackend):
            return math.nan
        return self.alpha_fraction * self.problem.alpha_max(self.backend.penalty(self.problem))

    @property
    def intercept(self) -> Array:
        """The intercept (n,) in the unit of the target; 0 where the problem has none."""
        if not isinstance(self.backend, PenalisedBackend):
            return self.problem.intercept_of(self.weights)
        loss = self.backend.penalty(self.problem).loss
        return self.problem.intercept_of(self.weights, loss)

    def predict(self, theta: Any) -> Array:
        """theta W + intercept for theta (r, k): shape (r,) of one target, (r, n) of several.

        theta: an array, frame or sparse matrix. Columns of a frame are matched to the problem's by
        name, in any order; a frame with none of these names is matched by position. Raises
        InputError where a column is missing or the number of columns differs.
        """
        names = self.problem.names
        labels = {str(label): label for label in getattr(theta, "columns", ())}
        if len(set(names)) == len(names) and not labels.keys().isdisjoint(names):
            if missing := [name for name in names if name not in labels]:
                raise InputError(
                    f"predict needs the column {shown(missing[0])}, which theta does not have"
                )
            theta = theta[[labels[name] for name in names]]
        values = getattr(theta, "to_numpy", lambda: theta)()
        rows = values if hasattr(values, "tocsr") else real_matrix(values, "rows")
        if rows.ndim != 2 or rows.shape[1] != self.problem.columns:
            raise InputError(f"predict needs {self.problem.columns} columns, not {rows.shape[-1]}")
        out: Array = np.asarray(rows @ self.weights) + self.intercept
        return out[:, 0] if out.shape[1] == 1 else out

    def to_frame(self) -> "pd.DataFrame":
        """The weights (k, n) as a frame: a row per column of theta, a column per target."""
        import pandas as pd

        names = pd.Index(self.problem.names, name="column")
        return pd.DataFrame(self.weights, index=names, columns=list(self.problem.target_names))

    def _repr_html_(self) -> str:
        """Status, certificate and the 30 largest weights, as HTML."""
        verified, support = self.certificate, self.support
        proof = f"{verified.kind} {verified.value:.1e}" if verified else "no certificate"
        penalty = "" if math.isnan(self.alpha) else f", alpha {self.alpha:.4g}"
        words = f"{self.backend!r}{penalty}: {self.status} ({proof}), "
        words += f"{len(support)} of {self.problem.columns} columns"
        words += f"; {self.reason}" if self.reason else ""
        rms = self.problem.design.rms[support, None]
        size = np.abs(self.weights[support] * rms).max(axis=1)
        shown = support[np.argsort(-size)][:30]
        table = self.to_frame().iloc[shown].to_html(float_format="{:.6g}".format)
        more = len(support) - len(shown)
        return f"<p>{html.escape(words)}</p>{table}" + (f"<p>and {more} more</p>" if more else "")

    @property
    def support(self) -> IntArray:
        """Indices (c,) of the columns with a nonzero weight for any target."""
        return np.flatnonzero(np.any((self.weights != 0) & np.isfinite(self.weights), axis=1))


@dataclass(frozen=True, eq=False, repr=False)
class Path(Brief):
    """Fits along a path of penalties, in the requested order: alpha = alpha_fraction * alpha_max.

    alpha_fractions: (p,). fits: p of them. seconds: wall time, with the certificates.
    """

    alpha_fractions: Array
    fits: tuple[Fit, ...]
    seconds: float

    @cached_property
    def alpha_max(self) -> float:
        """The smallest alpha whose solution is zero, in the unit of the target: of unit columns."""
        return self.fits[0].alpha / self.fits[0].alpha_fraction

    @property
    def alphas(self) -> Array:
        """The penalties alpha (p,), in the unit of the target."""
        return self.alpha_fractions * self.alpha_max

    def to_frame(self) -> "pd.DataFrame":
        """The weights as a frame: a row per penalty, indexed by alpha_fraction and alpha.

        Its columns are those of theta, or with several targets the pairs (target, column).
        """
        import pandas as pd

        problem = self.fits[0].problem
        index = pd.MultiIndex.from_arrays(
            [self.alpha_fractions, self.alphas], names=["alpha_fraction", "alpha"]
        )
        columns: pd.Index = pd.Index(problem.names, name="column")
        if problem.targets > 1:
            pairs = [problem.target_names, problem.names]
            columns = pd.MultiIndex.from_product(pairs, names=["target", "column"])
        flat = self.weights.transpose(0, 2, 1).reshape(len(self.fits), -1)
        return pd.DataFrame(flat, index=index, columns=columns)

    def plot(self, axes: Any = None) -> Any:
        """Plot the weights of columns of unit rms against alpha / alpha_max.

        axes: of matplotlib; None creates them. The legend names the ten largest weights; a cross
        marks each penalty that is not certified. Returns the axes.
        """
        frame, problem = self.to_frame().droplevel("alpha"), self.fits[0].problem
        frame = (frame * np.tile(problem.design.rms, problem.targets)).sort_index(ascending=False)
        size = frame.abs().max().fillna(0.0).to_numpy()
        largest = np.argsort(-size, kind="stable")[: max(np.count_nonzero(size), 1)]
        frame = frame.iloc[:, largest]
        frame.columns = [c if isinstance(c, str) else f"{c[1]} of {c[0]}" for c in frame.columns]
        doubtful = [fit.alpha_fraction for fit in self.fits if fit.status != "ok"]
        axes = frame.plot(ax=axes, logx=True, linewidth=1.0, legend=False)
        lines = axes.lines[-frame.shape[1] :][:10]
        if doubtful:
            lines += axes.plot(doubtful, np.zeros(len(doubtful)), "kx", label="not certified")
        axes.legend(handles=lines, fontsize="small")
        axes.invert_xaxis()
        axes.set_xlabel(r"$\alpha / \alpha_\mathrm{max}$")
        axes.set_ylabel("weight, column of unit rms")
        return axes

    def _repr_html_(self) -> str:
        """A table of penalty, columns in use, status and certificate, as HTML."""
        import pandas as pd

        content = {
            "alpha_fraction": self.alpha_fractions,
            "alpha": self.alphas,
            "columns": [len(fit.support) for fit in self.fits],
            "status": [fit.status for fit in self.fits],
            "certificate": self.gaps,
        }
        table = pd.DataFrame(content).to_html(float_format="{:.4g}".format, index=False)
        name = html.escape(self.fits[0].backend.name)
        return f"<p>{name}, {len(self.fits)} penalties, {self.seconds:.2g} s</p>{table}"

    @property
    def weights(self) -> Array:
        """Weights (p, k, n) in the original units of theta."""
        return np.stack([fit.weights for fit in self.fits])

    @property
    def gaps(self) -> Array:
        """Relative duality gap (p,) of each point, NaN where there is no solution."""
        return np.array([f.certificate.value if f.certificate else np.nan for f in self.fits])
