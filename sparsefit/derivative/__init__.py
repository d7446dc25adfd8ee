"""State derivatives from samples: differences (Eq. 15), fixed filters and one that tunes itself."""

from sparsefit.derivative.agreement import Agreement
from sparsefit.derivative.repair import Repairs
from sparsefit.derivative.rules import METHODS, Derivative
from sparsefit.derivative.samples import Samples
from sparsefit.derivative.smoothing import Smoothing
from sparsefit.derivative.weak import WeakRows

__all__ = ["METHODS", "Agreement", "Derivative", "Repairs", "Samples", "Smoothing", "WeakRows"]
