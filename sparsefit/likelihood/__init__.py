"""One likelihood of the raw log: the model, its smoother, and what a log says of it."""

from sparsefit.likelihood.model import Disturbance, Model, Process
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import Posterior, bound, measure
from sparsefit.likelihood.reference import ELEMENTS

__all__ = [
    "ELEMENTS",
    "Disturbance",
    "FlightLog",
    "Model",
    "Posterior",
    "Process",
    "StreamPattern",
    "bound",
    "measure",
]
