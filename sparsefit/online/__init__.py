"""Estimating on board, from samples as they come."""

from sparsefit.online.estimator import OnlineEstimator

__all__ = ["OnlineEstimator"]
