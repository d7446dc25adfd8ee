"""Pictures of a flow, an estimate and a path of weights, in one style, for people and pages."""

from sparsefit.plot.pictures import draw_estimate, draw_flow, draw_path
from sparsefit.plot.style import encoded

__all__ = ["draw_estimate", "draw_flow", "draw_path", "encoded"]
