"""Pictures of a flow and of an estimate, in one style, for people and pages."""

from sparsefit.plot.pictures import draw_estimate, draw_flow
from sparsefit.plot.style import encoded

__all__ = ["draw_estimate", "draw_flow", "encoded"]
