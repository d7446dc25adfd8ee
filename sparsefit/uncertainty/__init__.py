"""How sure an estimate is, and what smoothing and noise take from it."""

from sparsefit.uncertainty.assessment import (
    Assessment,
    ModeAssessment,
    assess,
    assess_flights,
    common,
    vehicles_of,
)
from sparsefit.uncertainty.causes import Cause, Suspect
from sparsefit.uncertainty.constancy import Constancy
from sparsefit.uncertainty.flow import FlowUncertainty
from sparsefit.uncertainty.goodness import Goodness
from sparsefit.uncertainty.lags import LAGS
from sparsefit.uncertainty.record import Uncertainty
from sparsefit.uncertainty.shape import Shape, ShapeUncertainty, values_of
from sparsefit.uncertainty.vehicle import VehicleUncertainty

__all__ = [
    "LAGS",
    "Assessment",
    "Cause",
    "Constancy",
    "FlowUncertainty",
    "Goodness",
    "ModeAssessment",
    "Shape",
    "ShapeUncertainty",
    "Suspect",
    "Uncertainty",
    "VehicleUncertainty",
    "assess",
    "assess_flights",
    "common",
    "values_of",
    "vehicles_of",
]
