"""How sure an estimate is, and what smoothing and noise take from it."""

from sparsefit.uncertainty.assess import Assessment, assess
from sparsefit.uncertainty.assess_rows import assess_rows, assess_scales
from sparsefit.uncertainty.model import LAGS, Fitted, uncertainty
from sparsefit.uncertainty.record import Uncertainty
from sparsefit.uncertainty.vehicle import VehicleUncertainty

__all__ = [
    "LAGS",
    "Assessment",
    "Fitted",
    "Uncertainty",
    "VehicleUncertainty",
    "assess",
    "assess_rows",
    "assess_scales",
    "uncertainty",
]
