"""State-space likelihood of a raw log: model, iterated smoother, posterior and diagnosis."""

from sparsefit.likelihood.model import Model, Process
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import Posterior, bound, measure
from sparsefit.likelihood.readings import FlightLog
from sparsefit.likelihood.reference import ELEMENTS

__all__ = [
    "ELEMENTS",
    "FlightLog",
    "Model",
    "Posterior",
    "Process",
    "StreamPattern",
    "bound",
    "measure",
]
