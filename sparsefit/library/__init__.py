"""The library of candidate functions, its grids of length scales and its nuisance columns."""

from sparsefit.library.builder import TARGET_NAMES, Library
from sparsefit.library.cells import CANDIDATES, candidate_columns
from sparsefit.library.grid import LengthScaleGrid

__all__ = ["CANDIDATES", "TARGET_NAMES", "LengthScaleGrid", "Library", "candidate_columns"]
