"""The library of candidate functions, its grids of length scales and its nuisance columns."""

from sparsefit.library.builder import TARGET_NAMES, Library
from sparsefit.library.cells import CANDIDATES, candidate_columns
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.library.wave_grid import WaveGrid

__all__ = [
    "CANDIDATES",
    "TARGET_NAMES",
    "LengthScaleGrid",
    "Library",
    "WaveGrid",
    "candidate_columns",
]
