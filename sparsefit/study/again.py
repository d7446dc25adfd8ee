"""One case of a study of flights, run once more in this process with all it was read from."""

from __future__ import annotations

from dataclasses import dataclass

from sparsefit import Fit
from sparsefit.errors import InputError, SparsefitError, described
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.flight.flow import Flow
from sparsefit.study.columns import Value
from sparsefit.study.definition import Definition
from sparsefit.study.flight_desk import Flown, estimator_of, read_case


@dataclass(frozen=True, eq=False)
class CaseAgain:
    """A case that was run again.

    flown: the flight, of several together the first; flow: the true one, None where there is none
    or nobody knows it; values: the columns of `cases.parquet` that are read from it, by name.
    """

    flown: Flight
    flow: Flow | None
    prepared: Prepared
    fit: Fit
    estimate: Estimate
    values: dict[str, Value]


def read_again(definition: Definition, unit: int, index: int) -> CaseAgain:
    """Fly, fit and read the case of a unit and a cell.

    Raises:
        SparsefitError: if the case fails, as it then did in the run, with its error.
    """
    cell = definition.flights.cells[index]
    try:
        flown = Flown.of(definition, unit, cell)
        estimator = estimator_of(definition, cell)
        prepared = cell.setup.online.prepare(estimator, flown.fleet)
        fit = estimator.fit(prepared)
        estimate, values = read_case(definition, flown, prepared, cell, fit)
    except InputError:
        raise
    except Exception as error:
        name = f"{unit:04d}-{cell.key}"
        raise SparsefitError(f"{name} ends in an error: {described(error)}") from error
    return CaseAgain(flown.fleet[0], flown.draw.flow, prepared, fit, estimate, values)
