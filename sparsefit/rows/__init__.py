"""Rows for the search: states and their derivatives, each a linear filter of the log."""

from sparsefit.rows.clean import Repairs
from sparsefit.rows.derivative import METHODS, Derivative, Samples, Smoothing

__all__ = ["METHODS", "Derivative", "Repairs", "Samples", "Smoothing"]
