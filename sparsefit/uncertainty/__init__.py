"""How sure an estimate is, and what smoothing and noise take from it."""

from sparsefit.uncertainty.assess import Assessment, assess
from sparsefit.uncertainty.model import LAGS, Fitted, uncertainty
from sparsefit.uncertainty.record import Uncertainty

__all__ = ["LAGS", "Assessment", "Fitted", "Uncertainty", "assess", "uncertainty"]
