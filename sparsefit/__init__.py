"""sparsefit: choose a sparse regression back-end, and prove the choice.

Names are imported when first used, so that the command line answers at once.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sparsefit.backends import fit as fit
    from sparsefit.backends import path as path
    from sparsefit.errors import InputError as InputError
    from sparsefit.errors import SparsefitError as SparsefitError
    from sparsefit.estimator import Estimate as Estimate
    from sparsefit.estimator.certificate_map import CertificateMap as CertificateMap
    from sparsefit.estimator.certificate_map import certificate_map as certificate_map
    from sparsefit.estimator.estimate import ScaleEstimate as ScaleEstimate
    from sparsefit.estimator.estimator import Estimator as Estimator
    from sparsefit.flight import Flight as Flight
    from sparsefit.flight import simulate_flight as simulate_flight
    from sparsefit.flight.faults import LogFaults as LogFaults
    from sparsefit.flight.flow import CellularFlow as CellularFlow
    from sparsefit.flight.flow import ShapedCells as ShapedCells
    from sparsefit.flight.flow import SuperposedFlow as SuperposedFlow
    from sparsefit.flight.turbulence import Turbulence as Turbulence
    from sparsefit.flight.vehicle import PointMassVehicle as PointMassVehicle
    from sparsefit.flight.vehicle import ThrustSeries as ThrustSeries
    from sparsefit.flight.waves import WaveFlow as WaveFlow
    from sparsefit.logs import read_flight as read_flight
    from sparsefit.logs import write_flight as write_flight
    from sparsefit.logs.checks import LogQuality as LogQuality
    from sparsefit.logs.checks import check_log as check_log
    from sparsefit.logs.checks import quality_of as quality_of
    from sparsefit.model import LengthScaleGrid as LengthScaleGrid
    from sparsefit.model import Library as Library
    from sparsefit.model import Readout as Readout
    from sparsefit.model import WaveGrid as WaveGrid
    from sparsefit.onboard import OnlineEstimator as OnlineEstimator
    from sparsefit.regression import Certificate as Certificate
    from sparsefit.regression import Fit as Fit
    from sparsefit.regression import Path as Path
    from sparsefit.regression import RegressionProblem as RegressionProblem
    from sparsefit.rows import Derivative as Derivative
    from sparsefit.score import ScalesScore as ScalesScore
    from sparsefit.score import Score as Score
    from sparsefit.score import prediction_error as prediction_error
    from sparsefit.score import score as score
    from sparsefit.score import score_scales as score_scales
    from sparsefit.study.study import Study as Study

__version__ = "0.4.0.dev0"

_HOMES = {
    "CellularFlow": "flight.flow",
    "SuperposedFlow": "flight.flow",
    "ShapedCells": "flight.flow",
    "WaveFlow": "flight.waves",
    "Turbulence": "flight.turbulence",
    "PointMassVehicle": "flight.vehicle",
    "ThrustSeries": "flight.vehicle",
    "Flight": "flight",
    "LogFaults": "flight.faults",
    "simulate_flight": "flight",
    "read_flight": "logs",
    "write_flight": "logs",
    "Derivative": "rows",
    "LogQuality": "logs.checks",
    "quality_of": "logs.checks",
    "check_log": "logs.checks",
    "LengthScaleGrid": "model",
    "Library": "model",
    "WaveGrid": "model",
    "RegressionProblem": "regression",
    "Certificate": "regression",
    "Fit": "regression",
    "Path": "regression",
    "fit": "backends",
    "path": "backends",
    "Readout": "model",
    "Estimate": "estimator",
    "Estimator": "estimator",
    "ScaleEstimate": "estimator",
    "CertificateMap": "estimator.certificate_map",
    "certificate_map": "estimator.certificate_map",
    "OnlineEstimator": "onboard",
    "ScalesScore": "score",
    "Score": "score",
    "prediction_error": "score",
    "score": "score",
    "score_scales": "score",
    "Study": "study.study",
    "InputError": "errors",
    "SparsefitError": "errors",
}
_ROOMS = ("backends", "estimator", "flows", "logs", "model", "penalties", "plot", "regression",
          "solvers", "study")  # fmt: skip
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
    return sorted(__all__)


class _Package(ModuleType):
    """Keeps sf.fit and sf.score the functions: importing their rooms would bind the modules."""

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and _HOMES.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
