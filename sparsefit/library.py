"""Candidate functions over a grid of length scales, and the regression problem they make.

Paper Eqs. 17-19: for every length scale L the 8 products and singles of sin and cos of
pi x / L and pi y / L. Column groups: the 8 columns of one length scale.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sparsefit.derivative import Samples
from sparsefit.errors import InputError, positive, unknown
from sparsefit.flight import Flight
from sparsefit.objective import Statistics, accumulate, row_blocks
from sparsefit.vehicle import PointMassVehicle

Array = NDArray[np.float64]
Target = Literal["flow-velocity", "acceleration", "state-derivative"]
Spacing = Literal["length-scale", "wavenumber"]

CANDIDATES = (
    "sin x",
    "sin y",
    "cos x",
    "cos y",
    "sin x sin y",
    "sin x cos y",
    "cos x sin y",
    "cos x cos y",
)
TARGET_NAMES: dict[str, tuple[str, ...]] = {
    "flow-velocity": ("w_x", "w_y"),
    "acceleration": ("dv_x/dt", "dv_y/dt"),
    "state-derivative": ("dx/dt", "dy/dt", "dv_x/dt", "dv_y/dt"),
}
BUILD_ROWS = 64
MAX_SCALES = 2_048  # k = 16 384 columns: Z'Z alone is 2 GiB
STREAM_BYTES = 2**30  # beyond this, theta is compressed as it is built
MAX_THETA_BYTES = 8 * 2**30


@dataclass(frozen=True)
class LengthScaleGrid:
    """The candidate length scales (Eq. 18), ascending [m].

    Uniform in length scale, L_lb, L_lb + dL, ..., L_ub (the paper's 1...12 m by 0.2 m is the
    default), or uniform in wavenumber k = pi/L with ``count`` scales between the same bounds.
    """

    lower: float = 1.0
    upper: float = 12.0
    step: float | None = None
    count: int | None = None
    spacing: Spacing = "length-scale"

    def __post_init__(self) -> None:
        if self.spacing not in get_args(Spacing):
            raise unknown("spacing", str(self.spacing), get_args(Spacing))
        for name in ("lower", "upper"):
            positive(f"grid: {name}", getattr(self, name), "m")
        if self.upper < self.lower:
            raise InputError(
                f"grid: upper ({self.upper:g} m) is below lower ({self.lower:g} m); swap them"
            )
        if self.step is not None and self.count is not None:
            raise InputError("grid: give step or count, not both")
        if self.spacing == "wavenumber" and self.count is None:
            raise InputError("grid: spacing 'wavenumber' needs count (the number of scales)")
        if self.step is not None:
            positive("grid: step", self.step, "m")
        whole = isinstance(self.count, int | np.integer) and not isinstance(self.count, bool)
        if self.count is not None and not (whole and self.count >= 1):
            raise InputError(f"grid: count must be an integer, at least 1, not {self.count!r}")
        if self.size > MAX_SCALES:
            raise InputError(
                f"grid: {self.size} length scales are more than the {MAX_SCALES} that can be "
                "held; use a larger step or a narrower range"
            )

    @classmethod
    def for_flight(
        cls, flight: Flight, lower: float = 1.0, upper: float = 12.0, *, fraction: float = 0.25
    ) -> "LengthScaleGrid":
        """The grid that resolves a flight: uniform in wavenumber, at a fraction of the lobe.

        The residual as a function of k has lobes of width 2 pi / extent; steps of a quarter of
        it, the default, put a candidate in every lobe. Finer at small L than a grid uniform in
        L, and coarser at large L.
        """
        if not 0 < fraction <= 1:
            raise InputError(f"grid: fraction of the lobe must be in (0, 1], not {fraction!r}")
        plain = cls(lower, upper)  # refuses bounds that are none
        span = np.pi / plain.lower - np.pi / plain.upper
        steps = np.ceil(span * flight.extent / (2 * np.pi * fraction))
        return cls(lower, upper, count=int(min(steps, 1e15)) + 1, spacing="wavenumber")

    @property
    def size(self) -> int:
        """Number of length scales."""
        if self.count is not None:
            return self.count
        # A hair of tolerance: (12 - 1)/0.2 is 54.99999999999999 in binary.
        steps = min((self.upper - self.lower) / self._step, 1e15)  # beyond any that can be held
        return int(np.floor(steps + 1e-9)) + 1

    @property
    def _step(self) -> float:
        return 0.2 if self.step is None else self.step

    @cached_property
    def scales(self) -> Array:
        """The length scales [m], ascending, shape (g,)."""
        if self.spacing == "wavenumber":
            return np.ascontiguousarray(
                1.0 / np.linspace(1.0 / self.upper, 1.0 / self.lower, self.size)[::-1]
            )
        if self.count is not None:
            return np.linspace(self.lower, self.upper, self.count)
        # Rounding to 12 digits gives 4.2, not 4.200000000000001, as the scale that is reported.
        return np.round(self.lower + self._step * np.arange(self.size), 12)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """theta = U diag(s) V': singular_values (r,), right_vectors V' (r, k), projected U'Y (r, n).

    seconds: what it took, so that every fit that uses it can be charged.
    """

    singular_values: Array
    right_vectors: Array
    projected: Array
    seconds: float = 0.0

    def retained(self, rcond: float | None, samples: int) -> NDArray[np.bool_]:
        """Singular values above rcond * s_max; None is the rounding level eps * max(m, k)."""
        if rcond is None:
            rcond = float(np.finfo(float).eps * max(samples, self.right_vectors.shape[1]))
        kept: NDArray[np.bool_] = self.singular_values > rcond * self.singular_values[0]
        return kept


@dataclass(frozen=True, eq=False)
class RegressionProblem:
    """target (m, n) ~ theta (m, k) W (k, n), with columns in groups.

    theta and target are finite and no column of theta is zero. ``groups`` (k,) numbers the
    group of each column from 0; ``group_scales`` (g,) gives its length scale [m] where it has one.
    ``sample_count``: m, where the rows are the triangle of a QR that keeps every inner product of
    the m original ones (`from_blocks`). ``position`` (m, 2) [m]: where theta's rows were taken, for
    back-ends that make columns of their own; None where it is not known row by row.
    """

    theta: Array
    target: Array
    groups: NDArray[np.intp]
    names: tuple[str, ...]
    target_names: tuple[str, ...]
    group_scales: Array | None = None
    sample_count: int | None = None
    position: Array | None = None

    def __post_init__(self) -> None:
        _check_shapes(self)
        squares = np.einsum("ij,ij->j", self.theta, self.theta)
        _refuse_columns(
            ~np.isfinite(squares),
            self.names,
            "holds NaN, infinity or values whose "
            "squares overflow; clean the data or change the unit",
        )
        _refuse_columns(
            squares == 0,
            self.names,
            "is zero in every sample (or so small that its "
            "square underflows); drop it or change the unit",
        )
        squares = np.einsum("ij,ij->j", self.target, self.target)
        _refuse_columns(
            ~np.isfinite(squares),
            self.target_names,
            "of the target holds NaN, infinity or values whose squares overflow",
        )

    @classmethod
    def from_arrays(
        cls,
        theta: ArrayLike,
        target: ArrayLike,
        groups: ArrayLike | None = None,
        names: Sequence[str] | None = None,
    ) -> "RegressionProblem":
        """A problem from any design matrix theta (m, k) and target (m,) or (m, n).

        ``groups``: k labels (of any kind that sorts), equal for the columns of one group; without
        them every column is a group of its own. Raises InputError on shapes that do not match,
        values that are not finite and columns of zeros.
        """
        design = _floats(theta, "theta")
        values = _floats(target, "target")
        values = values[:, None] if values.ndim == 1 else values
        if design.ndim != 2 or values.ndim != 2:
            raise InputError(
                f"theta must have shape (m, k) and target (m,) or (m, n), not {design.shape} and "
                f"{values.shape}"
            )
        labels = np.arange(design.shape[1]) if groups is None else np.asarray(groups)
        if labels.shape != (design.shape[1],):
            raise InputError(
                f"groups must have one label per column: {design.shape[1]} columns, groups of "
                f"shape {labels.shape}"
            )
        numbers = np.unique(labels, return_inverse=True)[1].astype(np.intp)
        columns = tuple(names) if names is not None else tuple(map(str, range(design.shape[1])))
        targets = tuple(map(str, range(values.shape[1])))
        return cls(design, values, numbers, columns, targets)

    @classmethod
    def from_blocks(
        cls,
        blocks: Iterable[tuple[Array, Array]],
        groups: ArrayLike | None = None,
        names: Sequence[str] | None = None,
    ) -> "RegressionProblem":
        """A problem from blocks of rows (theta, target), in memory of order k^2 + a block.

        Each block is folded into the triangle of a QR decomposition of [theta, target]. QR, and
        not Z'Z, because the certificate takes residuals of these rows: orthogonal
        transformations keep them to rounding, where Z'Z would lose half the digits.
        """
        triangle, count, columns = compressed(blocks)
        plain = cls.from_arrays(triangle[:, :columns], triangle[:, columns:], groups, names)
        return replace(plain, sample_count=count)

    @property
    def samples(self) -> int:
        """Number of samples m."""
        return self.sample_count or int(self.theta.shape[0])

    @property
    def columns(self) -> int:
        """Number of columns k."""
        return int(self.theta.shape[1])

    @property
    def targets(self) -> int:
        """Number of targets n."""
        return int(self.target.shape[1])

    @cached_property
    def statistics(self) -> Statistics:
        """Sufficient statistics in scaled columns, formed once and shared by all back-ends."""
        return accumulate(row_blocks(self.theta, self.target), count=self.samples)

    @cached_property
    def compressed(self) -> tuple[Array, Array]:
        """(theta, target) in at most k + n rows, by QR: every least-squares problem is the same."""
        if len(self.theta) <= self.columns + self.targets:
            return self.theta, self.target
        triangle = cast(Array, np.linalg.qr(np.hstack([self.theta, self.target]), mode="r"))
        return triangle[:, : self.columns], triangle[:, self.columns :]

    @cached_property
    def spectrum(self) -> Spectrum:
        """Singular values of theta, by QR first: the tall matrix is read once."""
        start = perf_counter()
        rows, target = self.compressed
        left, singular_values, right = np.linalg.svd(rows, full_matrices=False)
        projected = left.T @ target
        return Spectrum(singular_values, right, projected, perf_counter() - start)


@dataclass(frozen=True)
class Library:
    """The library builder: candidates over ``grid``, and what they are regressed on.

    ``target``: ``flow-velocity`` Phi = tau (v' - a) + v (Eq. 23), ``acceleration`` v', or
    ``state-derivative`` (x', v'), the literal reading of Eq. 20.
    """

    grid: LengthScaleGrid = LengthScaleGrid()
    target: Target = "flow-velocity"

    def __post_init__(self) -> None:
        if self.target not in TARGET_NAMES:
            raise unknown("target", str(self.target), TARGET_NAMES)

    def response(self, samples: Samples, vehicle: PointMassVehicle) -> Array:
        """What the candidates are regressed on, (m, n), one row per sample."""
        if self.target == "flow-velocity":
            return samples.flow_velocity(vehicle)
        if self.target == "acceleration":
            return samples.acceleration
        return np.hstack([samples.position_rate, samples.acceleration])

    def build(self, samples: Samples, vehicle: PointMassVehicle) -> RegressionProblem:
        """The regression problem of a flight: theta (m, 8 g), group-major, and the target.

        Flights whose theta would exceed 1 GiB are compressed block by block
        (`RegressionProblem.from_blocks`): the same solutions and certificates, memory of k^2.
        """
        scales = self.grid.scales
        for axis, values in zip("xy", samples.position.T, strict=True):
            if not values.any():
                raise InputError(
                    f"the flight stays on the line {axis} = 0, where the candidates of sin {axis} "
                    "are zero: no length scale can be told; leave that line"
                )
        held = len(samples.time) * len(scales) * len(CANDIDATES) * 8
        target = self.response(samples, vehicle)
        columns = len(scales) * len(CANDIDATES)
        if held > STREAM_BYTES and len(samples.time) > columns + target.shape[1]:
            pieces = row_blocks(samples.position, target)
            triangle, count, _ = compressed(
                (candidate_columns(position, scales), values) for position, values in pieces
            )
            theta, target = triangle[:, :columns].copy(), triangle[:, columns:].copy()
            position = None
        else:
            theta, count = candidate_columns(samples.position, scales), len(target)
            position = samples.position
        return RegressionProblem(
            theta,
            target,
            np.repeat(np.arange(len(scales)), len(CANDIDATES)),
            tuple(f"{name} (L = {scale:g} m)" for scale in scales for name in CANDIDATES),
            TARGET_NAMES[self.target],
            scales,
            count,
            position,
        )


def compressed(blocks: Iterable[tuple[Array, Array]]) -> tuple[Array, int, int]:
    """(triangle, m, k): R (at most k + n rows) of a QR of the rows [theta, target], in blocks."""
    triangle: Array | None = None
    count = columns = 0
    for theta, target in blocks:
        rows = np.hstack([theta, target])
        count, columns = count + len(rows), theta.shape[1]
        stacked = rows if triangle is None else np.vstack([triangle, rows])
        triangle = cast(Array, np.linalg.qr(stacked, mode="r"))
    if triangle is None:
        raise InputError("no blocks: a regression problem needs at least one")
    return triangle, count, columns


def candidate_columns(position: Array, scales: Array) -> Array:
    """Theta (m, 8 g) of Eq. 19, group-major: one sine and cosine per scale and axis, then products.

    position (m, 2) [m]; scales (g,) [m].
    """
    size = len(position) * len(scales) * len(CANDIDATES) * 8
    if size > MAX_THETA_BYTES:
        raise InputError(
            f"a library of {len(position)} samples x {len(scales)} scales x 8 needs "
            f"{size / 2**30:.1f} GiB; use fewer scales or samples"
        )
    theta = np.empty((len(position), len(scales), len(CANDIDATES)))
    wavenumbers = np.pi / scales
    # Rows in blocks, so that sines, cosines and their products stay in cache.
    for rows, block in row_blocks(theta, position, size=BUILD_ROWS):
        x, y = block[:, :1] * wavenumbers, block[:, 1:] * wavenumbers
        sin_x, cos_x, sin_y, cos_y = np.sin(x), np.cos(x), np.sin(y), np.cos(y)
        rows[..., 0], rows[..., 1], rows[..., 2], rows[..., 3] = sin_x, sin_y, cos_x, cos_y
        np.multiply(sin_x, sin_y, out=rows[..., 4])
        np.multiply(sin_x, cos_y, out=rows[..., 5])
        np.multiply(cos_x, sin_y, out=rows[..., 6])
        np.multiply(cos_x, cos_y, out=rows[..., 7])
    return theta.reshape(len(position), -1)


def _floats(values: ArrayLike, name: str) -> Array:
    try:
        if np.iscomplexobj(values):
            raise TypeError("it is complex")
        return np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of real numbers: {error}") from None


def _check_shapes(problem: RegressionProblem) -> None:
    (m, k), rows = problem.theta.shape, problem.target.shape[0]
    if rows != m:
        raise InputError(
            f"theta {problem.theta.shape} and target {problem.target.shape} must have the same "
            "number of rows"
        )
    if m == 0 or k == 0 or problem.target.shape[1] == 0:
        raise InputError(
            f"theta {problem.theta.shape} and target {problem.target.shape} must not be empty"
        )
    if len(problem.names) != k:
        raise InputError(f"names must have one name per column: {k}, not {len(problem.names)}")


def _refuse_columns(bad: NDArray[np.bool_], names: Sequence[str], what: str) -> None:
    found = np.flatnonzero(bad)
    if len(found):
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise InputError(f"column {names[found[0]]!r}{more} {what}")
