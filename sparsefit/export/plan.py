"""What of an estimator can run on board: sizes and settings that its C is made from, or why not.

What fits: sums of one flight in memory that does not grow, and answers in time that is bounded.
A derivative from a few samples, columns of cells on a fixed grid, a back-end that needs nothing but
those sums, and a readout of one length scale, on the grid or between its wavenumbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.best_scale import BestScale
from sparsefit.backends.lasso import Lasso
from sparsefit.backends.stlsq import STLSQ
from sparsefit.cached import cached_property
from sparsefit.derivative import Derivative
from sparsefit.derivative.kernels import polynomial_kernels
from sparsefit.errors import InputError, one_of
from sparsefit.estimator import Estimator
from sparsefit.library.cells import CANDIDATES
from sparsefit.modes.space import FALSE_ALARM, SIGNIFICANCE, WIND
from sparsefit.modes.stack import CORRELATION

Real = Literal["double", "float"]
BACKENDS = (BestScale, STLSQ, Lasso)
WINDOWS = {"forward": 2, "midpoint": 2, "central": 3}  # samples of the derivatives on board; savgol
FEWEST_SCALES = 3  # a minimum has two sides
MOST_RAM = 1 << 20  # bytes: most of what a processor of this class has
COARSE = 0.3  # of a lobe 2 pi/extent: steps of the grid in k beyond it are not interpolated
STEPS: dict[Real, int] = {"double": 14, "float": 10}  # of a descent: of 140 none took more than 11
END: dict[Real, float] = {"double": 1e-12, "float": 1e-6}  # of an interval: a step that is none
FREEDOM = 2 * len(CANDIDATES) + 1 - WIND  # parameters of a mode beyond those of a wind


@dataclass(frozen=True)
class Plan:
    """An estimator for a processor: what the C and its model in Python are made from.

    estimator: whose derivative, library, back-end and readout can run on board. real: the C type
    of all numbers. Raises InputError, on one line with all causes and their remedies, where a part
    cannot.
    """

    estimator: Estimator
    real: Real = "double"

    def __post_init__(self) -> None:
        one_of("C type", self.real, get_args(Real))
        obstacles = (*_obstacles(self.estimator), *self._of_real())
        if obstacles:
            raise InputError(f"this estimator cannot run on board: {'; '.join(obstacles)}")

    def _of_real(self) -> Iterator[str]:
        backend = self.estimator.backend
        if self.real == "float" and isinstance(backend, STLSQ) and backend.unbias:
            yield (
                "the last least squares of stlsq, on columns that resemble each other, is more "
                "than float holds (use --double, or unbias false)"
            )

    @property
    def derivative(self) -> Derivative:
        """How velocities become accelerations."""
        assert isinstance(self.estimator.derivative, Derivative)
        return self.estimator.derivative

    @property
    def backend(self) -> BestScale | STLSQ | Lasso:
        """The back-end, one of those that fit."""
        assert isinstance(self.estimator.backend, BACKENDS)
        return self.estimator.backend

    @cached_property
    def scales(self) -> Array:
        """Candidate length scales (g,) [m], ascending."""
        return self.estimator.library.grid.scales

    @cached_property
    def wavenumbers(self) -> Array:
        """k = pi/L (g,) [1/m], descending."""
        wavenumbers: Array = np.pi / self.scales
        return wavenumbers

    @property
    def columns(self) -> int:
        """Columns whose whole Gram matrix is kept: 8 a scale, or none where scales stand alone."""
        return 0 if isinstance(self.backend, BestScale) else len(CANDIDATES) * len(self.scales)

    @property
    def refined(self) -> bool:
        """Whether the length scale is read between those of the grid."""
        return self.estimator.readout.refine != "none"

    @property
    def orders(self) -> int:
        """Taylor coefficients in k of every sum: three where they are interpolated."""
        return 3 if self.refined else 1

    @property
    def window(self) -> int:
        """Samples that a derivative is taken from."""
        return WINDOWS.get(self.derivative.method) or int(self.derivative.window or 0)

    @property
    def kernels(self) -> tuple[Array, Array]:
        """Weights (window,) of the samples in the value, and in the slope times the step."""
        order = self.derivative.order or 0
        value, slope, _ = polynomial_kernels(self.window, order, 1.0)
        return value, slope

    @property
    def floor(self) -> float:
        """Of a pivot of columns in unit norm: below it a column counts as dependent."""
        return 1e-9 if self.real == "double" else 1e-5

    @property
    def safe(self) -> float:
        """The least pivot of an answer: below it rounding takes more than is promised.

        In float answers were off by up to 2e-7 / pivot, and 1e-5 is promised.
        """
        return 1e-6 if self.real == "double" else 2e-2

    @property
    def largest(self) -> float:
        """Of positions [m] and velocities [m/s]; in float a phase has three digits there."""
        return 1e7 if self.real == "double" else 1e4

    @property
    def rounding(self) -> float:
        """Of |Phi|^2: residuals below it are rounding."""
        return 1e-13 if self.real == "double" else 1e-6

    @property
    def settled(self) -> float:
        """Of |Phi|/sqrt(m): steps of a descent below it are none."""
        return 1e-13 if self.real == "double" else 1e-7

    @property
    def correlation(self) -> float:
        """Rows over which errors of Phi correlate, at least: as in a search of the whole flight."""
        if self.derivative.method != "savgol":
            return CORRELATION
        return max(CORRELATION, self.window / ((self.derivative.order or 0) + 1))

    @cached_property
    def detection(self) -> float:
        """What 2 ln(likelihood ratio) reaches by chance in one flight of 1000, over all scales."""
        from scipy.special import chdtri

        return float(chdtri(FREEDOM, FALSE_ALARM / len(self.scales)))

    @property
    def precision(self) -> float:
        """The share of a length scale that twice its standard error may be."""
        return self.estimator.readout.precision

    @property
    def distinct(self) -> float:
        """What it has to exceed before a rival is excluded."""
        return 2 * math.log(len(self.scales) / SIGNIFICANCE)


def _obstacles(estimator: Estimator) -> Iterator[str]:
    """Every cause that keeps an estimator from a processor, with its remedy."""
    library, readout, backend = estimator.library, estimator.readout, estimator.backend
    assert not isinstance(backend, str)
    yield from _of_backend(estimator)
    assert isinstance(estimator.derivative, Derivative)
    method = estimator.derivative.method
    if method not in (*WINDOWS, "savgol"):
        yield (
            f"derivative {method!r} needs the whole flight (use --derivative savgol, midpoint, "
            "central or forward)"
        )
    if library.family != "cells":
        yield f"family {library.family!r} has no sums on a fixed grid of scales (use 'cells')"
    if library.target != "flow-velocity":
        yield f"target {library.target!r} is not the flow (use 'flow-velocity')"
    if library.unknown:
        yield f"unknown {', '.join(library.unknown)}: on board the vehicle is known (leave it out)"
    yield from _of_grid(estimator)
    if readout.scales != "one":
        yield "several scales are a search over all rows (use scales 'one')"
    if readout.mean_velocity != "rms":
        yield f"readout {readout.mean_velocity!r} needs a search or all rows (use 'rms')"
    if readout.refine == "ladder":
        yield "refine 'ladder' needs all rows (use --refine variable-projection or none)"
    if readout.refine != "none" and readout.correction != "none":
        yield f"correction {readout.correction!r} needs all rows (use --correction none)"


def _of_backend(estimator: Estimator) -> Iterator[str]:
    backend = estimator.backend
    names = " or ".join(kind.name for kind in BACKENDS)
    if not isinstance(backend, BACKENDS):
        name = getattr(backend, "name", str(backend))
        yield f"back-end {name!r} has no solver of bounded work here (use --backend {names})"
    elif isinstance(backend, Lasso) and not isinstance(backend.alpha_fraction, float | int):
        yield "alpha_fraction 'auto' is chosen from all rows (give a number)"
    elif isinstance(backend, STLSQ) and backend.mode != "scaled":
        yield f"stlsq in mode {backend.mode!r} depends on the number of rows (use 'scaled')"
    elif isinstance(backend, BestScale) and backend.rcond is not None:
        yield "best-scale with rcond needs singular values (leave rcond out)"


def _of_grid(estimator: Estimator) -> Iterator[str]:
    grid = estimator.library.grid
    if grid.spacing == "flight":
        yield "a grid of spacing 'flight' is not fixed (use --extent, the flight's, in m)"
    elif grid.size < FEWEST_SCALES and estimator.readout.refine != "none":
        yield f"a grid of {grid.size} scales has no minimum inside (give {FEWEST_SCALES} or more)"
