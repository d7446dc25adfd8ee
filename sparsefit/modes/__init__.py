"""Modes off the grid: their projection, the search for them, and what is read from them."""

from sparsefit.modes.readout import Readout

__all__ = ["Readout"]
