"""Penalties on weights, and the losses they are added to: classes to use, and to derive from."""

from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import RootSquares, Squares
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import (
    AbsoluteValues,
    BoundedValues,
    Penalty,
    SquaredNorm,
    alpha_max,
)

__all__ = ["AbsoluteValues", "BoundedValues", "FusedNorm", "GroupNorms", "NestedNorms", "Penalty",
           "RootSquares", "SortedNorm", "SquaredNorm", "Squares", "alpha_max"]  # fmt: skip
