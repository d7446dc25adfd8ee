"""Figures of a flow and of an estimate, and their common style."""

from sparsefit.plot.pictures import draw_estimate, draw_flow
from sparsefit.plot.style import encoded

__all__ = ["draw_estimate", "draw_flow", "encoded"]
