"""What a back-end of another package does wrong, found on one problem before a study is.

The contract: a frozen dataclass whose ``solve`` is pure, returns what fits better than nothing, and
has a certificate that can fail. The front door (`sparsefit.fit`) looks after the rest.
"""

import dataclasses
import io
from collections.abc import Iterator
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from sparsefit.errors import InputError, one_line
from sparsefit.regression.backend import Backend, Solution
from sparsefit.regression.fit import fit
from sparsefit.regression.problem import RegressionProblem


def faults(backend: Backend, problem: RegressionProblem) -> list[str]:
    """A sentence for everything that is found; none where the back-end keeps the contract."""
    try:
        return list(_faults(backend, problem))
    except ModuleNotFoundError as error:
        return [one_line(f"it needs the package {error.name!r}, which is not installed")]
    except Exception as error:  # of code of others, or of what it returned: the last fault
        return [one_line(f"raises {type(error).__name__}: {error}")]


def _faults(backend: Any, problem: RegressionProblem) -> Iterator[str]:
    if not type(backend).__dataclass_params__.frozen:
        yield "its class is not frozen: write @dataclass(frozen=True)"
    printed = io.StringIO()
    with redirect_stdout(printed):
        first, second = _solved(backend, problem), _solved(backend, problem)
    if printed.getvalue():
        yield f"it prints: {one_line(printed.getvalue())[:60]!r}"
    weights, again = first.weights, second.weights
    if weights is None or again is None:
        yield "it has no weights for a problem that every least-squares solver solves"
        return
    if np.linalg.norm(weights - again) > 1e-6 * np.linalg.norm(weights):
        yield "it answers the same problem differently the second time: solve must be pure"
    elif first.status == "ok" and (judged := fit(problem, backend)).status != "ok":
        yield f"it says ok of an answer that is not: {judged.reason}"
    residual = np.linalg.norm(problem.target - problem.design.raw_predict(weights))
    if not residual <= (1.0 + 1e-9) * np.linalg.norm(problem.target):
        yield "its weights fit the target worse than zeros do"
    if dataclasses.replace(backend) != backend:
        yield "two of it with the same settings are not equal: it is no plain dataclass"


def _solved(backend: Backend, problem: RegressionProblem) -> Solution:
    arrays = {name: getattr(problem, name) for name in ("theta", "target", "groups")}
    lent = {name: values.copy() for name, values in arrays.items()}
    solution = backend.solve(dataclasses.replace(problem, **lent))
    for name, values in arrays.items():
        if not np.array_equal(lent[name], values):
            where = f"writes into problem.{name}, which it is given to read: work on a copy"
            raise InputError(f"back-end {backend.name!r} {where}")
    return solution
