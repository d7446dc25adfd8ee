"""What an online estimator is made of, and which estimators can be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError, positive
from sparsefit.estimator import Estimator
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import TARGET_NAMES, Library
from sparsefit.library.columns import LibraryColumns, cell_columns

SPANS = {"forward": 2, "midpoint": 2, "central": 3}  # samples that make a row; savgol: its window
FORGOTTEN = 5.0  # memories: older samples weigh less than 1 % of the newest, and are left out


@dataclass(frozen=True, eq=False)
class Settings:
    """An estimator that can follow a stream, its vehicle, and how far it looks back.

    Args:
        estimator: with a local derivative and a library of cells on a grid of its own.
        vehicle: that flies.
        reach: how far back the samples are taken from [s].
        memory: the time in which the weight of a sample falls by e [s]; inf: all weigh alike.
    """

    estimator: Estimator
    vehicle: PointMassVehicle
    reach: float
    memory: float = math.inf

    @classmethod
    def of(
        cls,
        estimator: Estimator,
        vehicle: PointMassVehicle,
        window: float | None,
        memory: float | None,
    ) -> Settings:
        """The settings of a sliding or of an exponential window.

        Raises:
            InputError: where the estimator cannot follow a stream, naming what stands in the way,
                or unless one of window and memory is given.
        """
        if not isinstance(estimator, Estimator):
            raise InputError(f"online: estimator must be an Estimator, not {estimator!r}")
        if not isinstance(vehicle, PointMassVehicle):
            raise InputError(f"online: vehicle must be a PointMassVehicle; got {vehicle!r}")
        if (window is None) == (memory is None):
            raise InputError("online: give window or memory [s], one of the two")
        refuse_unfit(estimator)
        if window is not None:
            return cls(estimator, vehicle, positive("window", window, "s"))
        assert memory is not None
        forgets = positive("memory", memory, "s")
        return cls(estimator, vehicle, FORGOTTEN * forgets, forgets)

    @property
    def derivative(self) -> Derivative:
        """The estimator's."""
        assert isinstance(self.estimator.derivative, Derivative)
        return self.estimator.derivative

    @property
    def library(self) -> Library:
        """The estimator's."""
        return self.estimator.library

    @property
    def columns(self) -> LibraryColumns:
        """The columns of its grid."""
        return cell_columns(self.library.grid.scales)

    @property
    def targets(self) -> int:
        """The number of regression targets."""
        return len(TARGET_NAMES[self.library.target])

    @property
    def span(self) -> int:
        """The number of samples that make one row."""
        return SPANS.get(self.derivative.method) or self.derivative.window or 0

    @property
    def searched(self) -> bool:
        """Whether one mode is looked for off the grid."""
        readout, grid = self.estimator.readout, self.library.grid
        return readout.refine != "none" and readout.scales == "one" and grid.lower < grid.upper

    @property
    def behind(self) -> float:
        """Steps from the middle of a row's samples to the newest of them."""
        if self.derivative.method == "forward":
            return 1.0
        return 0.5 * (self.span - 1)

    @property
    def fades(self) -> bool:
        """Whether older samples weigh less."""
        return math.isfinite(self.memory)

    def weight(self, ages: Array | float) -> Array:
        """The weights of samples by their ages [s], that of the newest 1."""
        return np.exp(-np.asarray(ages, dtype=float) / self.memory)


def refuse_unfit(estimator: Estimator) -> None:
    """Raise InputError where an estimator cannot follow a stream: what stands in the way."""
    derivative, library = estimator.derivative, estimator.library
    assert isinstance(derivative, Derivative)
    if derivative.method not in (*SPANS, "savgol"):
        raise InputError(
            f"online: derivative {derivative.method!r} tunes itself to a whole flight; take "
            "savgol, central, midpoint or forward"
        )
    if derivative.repair:
        raise InputError(
            "online: repairs look at a whole flight; take "
            f"Derivative({derivative.method!r}, repair=False)"
        )
    for setting, stands in (
        (f"family {library.family!r}", library.family != "cells"),
        (f"unknown {list(library.unknown)}", bool(library.unknown)),
        (f"every {library.every}", library.every != 1),
        ("grid spacing 'flight'", library.grid.spacing == "flight"),
    ):
        if stands:
            raise InputError(
                f"online: library {setting} needs the whole flight at once; take family 'cells' "
                "on a grid of its own, every = 1, nothing unknown"
            )
