"""One case of a study, run once more in this process with everything it was read from kept."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.codec import shown
from sparsefit.errors import InputError, SparsefitError, described
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.flight.flow import Flow
from sparsefit.regression.fit import Fit
from sparsefit.study.run.columns import Value, values_of
from sparsefit.study.run.execution import fly
from sparsefit.study.run.kind import Place
from sparsefit.study.run.kinds import kind_of
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.reading import Reading
from sparsefit.study.spec.identity import AnyStudy
from sparsefit.study.spec.plan import Case
from sparsefit.study.spec.solver_study import SolverStudy
from sparsefit.study.spec.study import Study


@dataclass(frozen=True, eq=False)
class OneCase:
    """A case that was run again: what was flown, fitted and read.

    flown: the flight, of several together the first; flow: the true one, None where there is none
    or nobody knows it; values: what the columns of `cases.parquet` read from the case, by name.
    """

    case: Case
    flown: Flight
    flow: Flow | None
    prepared: Prepared
    fit: Fit
    estimate: Estimate
    values: dict[str, Value]


def find_case(study: AnyStudy, case_id: str) -> tuple[int, int]:
    """Return (flight, cell) of the planned case of this id, `0007-3f9c0d6a41b2e857`.

    Raises:
        InputError: if the study plans none of this id, with the nearest that it does.
    """
    kind = kind_of(study)
    if (case := kind.find(case_id)) is not None:
        return case
    number = case_id.partition("-")[0]
    flight = int(number) if number.isdecimal() and len(number) < 10 else 0
    ids = [kind.case_id(min(flight, study.count - 1), cell.index) for cell in study.cells]
    near = (difflib.get_close_matches(case_id, ids, 1) or ids)[0]
    raise InputError(
        f"{study.name} plans no case {shown(case_id)}: ids stand in its cases.parquet and "
        f"report.html, {near} say"
    )


def solved_again(study: SolverStudy, case_id: str) -> Outcome:
    """Solve, judge and time one case of a study of solvers, alone in a process of its own.

    Raises:
        InputError: if the study plans none of this id.
    """
    kind, case = kind_of(study), find_case(study, case_id)
    wanted = np.zeros((study.count, len(study.cells)), dtype=bool)
    wanted[case] = True
    ((outcome, _),) = kind.compute(wanted, Place(), lambda: False)
    return replace(outcome, version=kind.version(case[1]))


def run_again(study: Study, case_id: str) -> OneCase:
    """Fly, fit and read one case, alone, as `study run` does.

    Raises:
        InputError: if the study plans none of this id, or what it asks for cannot be.
        SparsefitError: if the case fails, as it then did in the run, with what it raised.
    """
    flight, cell = find_case(study, case_id)
    case = Case(flight, study.cells[cell])
    draw = study.draw(case.flight, case.cell)
    try:
        fleet, yardstick = fly(study, case.flight, draw)
        estimator = study.estimator(case.cell)
        prepared = case.cell.setup.online.prepare(estimator, fleet)
        fit = estimator.fit(prepared)
        estimate = estimator.read(prepared, fit)
        reading = Reading(estimate, fit, prepared.problem, draw.flow, yardstick)
        values = values_of(reading)
    except InputError:
        raise
    except Exception as error:
        raise SparsefitError(f"{case.case_id} ends in an error: {described(error)}") from error
    return OneCase(case, fleet[0], draw.flow, prepared, fit, estimate, values)
