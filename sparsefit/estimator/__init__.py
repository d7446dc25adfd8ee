"""From a flight to the flow's parameters."""

from sparsefit.estimator.estimate import Doubt, Estimate, ScaleEstimate
from sparsefit.estimator.estimator import Estimator

__all__ = ["Doubt", "Estimate", "Estimator", "ScaleEstimate"]
