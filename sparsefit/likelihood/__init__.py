"""One likelihood of the raw log: the model, its smoother, and what a log says of it."""

from sparsefit.likelihood.limit import bound
from sparsefit.likelihood.model import (
    ELEMENTS,
    Disturbance,
    Model,
    Motion,
    Parameter,
    Process,
    Sensor,
)
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import Posterior, Track
from sparsefit.likelihood.smoother import Smoothing, measure

__all__ = [
    "ELEMENTS",
    "Disturbance",
    "FlightLog",
    "Model",
    "Motion",
    "Parameter",
    "Posterior",
    "Process",
    "Sensor",
    "Smoothing",
    "StreamPattern",
    "Track",
    "bound",
    "measure",
]
