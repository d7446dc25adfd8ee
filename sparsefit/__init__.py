"""sparsefit: choose a sparse regression back-end, and prove the choice.

The names of a first program are here; the others are in `sparsefit.flows`, `.penalties`,
`.solvers`, `.logs`, `.study`, `.plot` and the other rooms. All are imported when first used, so
that the command line answers at once.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # that of `typing`, whose import takes longer than all of this file
if TYPE_CHECKING:
    from typing import Any

    from sparsefit import backends as backends
    from sparsefit import estimator as estimator
    from sparsefit import flows as flows
    from sparsefit import logs as logs
    from sparsefit import model as model
    from sparsefit import penalties as penalties
    from sparsefit import plot as plot
    from sparsefit import regression as regression
    from sparsefit import score as score
    from sparsefit import solvers as solvers
    from sparsefit import study as study
    from sparsefit.backends import fit as fit
    from sparsefit.backends import path as path
    from sparsefit.errors import InputError as InputError
    from sparsefit.estimator.estimator import Estimator as Estimator
    from sparsefit.flight import Flight as Flight
    from sparsefit.flight import simulate_flight as simulate_flight
    from sparsefit.flight.flow import CellularFlow as CellularFlow
    from sparsefit.flight.vehicle import PointMassVehicle as PointMassVehicle
    from sparsefit.logs import read_flight as read_flight
    from sparsefit.logs import write_flight as write_flight
    from sparsefit.model import Library as Library
    from sparsefit.model import Readout as Readout
    from sparsefit.onboard import OnlineEstimator as OnlineEstimator
    from sparsefit.regression import RegressionProblem as RegressionProblem
    from sparsefit.rows import Derivative as Derivative
    from sparsefit.study.study import Study as Study

__version__ = "0.4.0"

_HOMES = {
    "CellularFlow": "flight.flow",
    "PointMassVehicle": "flight.vehicle",
    "Flight": "flight",
    "simulate_flight": "flight",
    "read_flight": "logs",
    "write_flight": "logs",
    "Estimator": "estimator",
    "Derivative": "rows",
    "Library": "model",
    "Readout": "model",
    "OnlineEstimator": "onboard",
    "RegressionProblem": "regression",
    "fit": "backends",
    "path": "backends",
    "Study": "study.study",
    "InputError": "errors",
}
_ROOMS = ("backends", "estimator", "flows", "logs", "model", "onboard", "penalties", "plot",
          "pysindy", "regression", "score", "sklearn", "solvers", "study")  # fmt: skip
__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"{__name__}.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS])
