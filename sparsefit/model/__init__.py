"""The model: candidate functions, parameters from their weights, and the search for flows."""

from sparsefit.model.grid import CANDIDATES, LengthScaleGrid, candidate_columns
from sparsefit.model.ladder import Start, propose
from sparsefit.model.library import TARGET_NAMES, Library
from sparsefit.model.readout import Readout, read_grid
from sparsefit.model.search import Proposal, Search, flight_weights

__all__ = [
    "CANDIDATES",
    "TARGET_NAMES",
    "LengthScaleGrid",
    "Library",
    "Proposal",
    "Readout",
    "Search",
    "Start",
    "candidate_columns",
    "flight_weights",
    "propose",
    "read_grid",
]
