"""`sparsefit backends`: the back-ends with their settings, and whether one works here."""

from __future__ import annotations

import argparse
import dataclasses
import io
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import SETTING, Option, Verbs, verb
from sparsefit.cli.terminal import Reply
from sparsefit.errors import InputError, MissingExtra, one_line, one_of, positive

if TYPE_CHECKING:
    from sparsefit.regression.backend import Backend, Solution
    from sparsefit.regression.problem import RegressionProblem

ANSWER = ("status", "reason", "settings", "certificate", "seconds", "mean_velocity", "length_scale")
ABOUT = """List the back-ends with their settings, or check that one works.

example:
  sparsefit backends
  sparsefit backends check group-lasso --setting solver=clarabel
"""
NAME = Option("name", "a back-end, see sparsefit backends list", "NAME")
TIMEOUT = Option("--timeout", "time limit of a plug-in; default: 60", "s", float,
                 default=60.0)  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb; without an action it lists."""
    parser = verb(verbs, "backends", run_list, about=ABOUT)
    actions = parser.add_subparsers(metavar="ACTION", title="actions")
    verb(actions, "list", run_list)
    verb(actions, "check", run_check, (NAME, SETTING, TIMEOUT))


def run_list(args: argparse.Namespace) -> Reply:
    """List the back-ends, plug-ins included, with their settings and defaults.

    example:
      sparsefit backends list --json
    """
    from sparsefit import backends
    from sparsefit.solvers.registry import solver_names
    from sparsefit.study.worker import in_child

    def record(name: str) -> dict[str, Any]:
        try:
            ours = name in (*backends.BACKENDS, *backends.PUBLIC)
            return _record(name) if ours else in_child(_record, name, seconds=20.0)
        except InputError as error:
            return {"name": name, "error": str(error)}

    return Reply({
        "backends": [record(name) for name in (*backends.known(), *backends.PUBLIC)],
        "solvers": [*solver_names()],
    })  # fmt: skip


def _record(name: str) -> dict[str, Any]:
    from sparsefit import backends

    try:
        loaded = backends.load(name)
        settings = backends.settings_of(backends.get(name))
    except MissingExtra as error:
        return {"name": name, "missing": str(error)}
    summary = " ".join((loaded.__doc__ or "").strip().split("\n\n")[0].split())
    kind = loaded.certificate_kind
    return {"name": name, "summary": summary, "certificate": kind, "settings": settings}


def run_check(args: argparse.Namespace) -> Reply:
    """Run a back-end on a small flight whose answer is known; a plug-in must keep the contract.

    example:
      sparsefit backends check lasso --setting alpha_fraction=0.05
    """
    from sparsefit import backends
    from sparsefit.study.worker import in_child

    one_of("back-end", args.name, (*backends.known(), *backends.PUBLIC))
    settings, seconds = dict(args.setting), positive("--timeout", args.timeout, "s")
    if args.name in backends.BACKENDS:
        record = _tried(args.name, settings)
    else:
        try:
            record = in_child(_tried, args.name, settings, seconds=seconds)
        except InputError as error:
            named = "" if args.name in str(error) else f"back-end {args.name!r} "
            raise InputError(f"{named}{error}") from None
    return Reply(record, None, int(record["status"] != "ok" or bool(record["faults"])))


def _tried(name: str, settings: dict[str, Any]) -> dict[str, Any]:
    """The answer of the back-end on a small flight, JSON-ready."""
    import sparsefit as sf
    from sparsefit.solvers.kernels import compiled

    backend = sf.backends.get(name, **settings)
    truth, vehicle = sf.CellularFlow(15.0, 4.0), sf.PointMassVehicle(0.5, (5.0, 3.0))
    flight = sf.simulate_flight(truth, vehicle, duration=10.0, sample_rate=50.0, seed=7)
    library = sf.Library(sf.model.LengthScaleGrid(3.0, 5.0, 1.0))
    estimator = sf.Estimator(library=library, backend=backend)
    prepared = estimator.prepare(flight)
    wrong = [] if name in sf.backends.BACKENDS else faults(backend, prepared.problem)
    record = {"status": "error", "reason": "it breaks the contract of a back-end"}
    try:
        record = estimator.read(prepared, estimator.fit(prepared)).to_dict()
    except Exception:  # any: a fault that was found describes it better
        if not wrong:
            raise
    answer = {key: record[key] for key in ANSWER if key in record}
    true = {"true_mean_velocity": truth.mean_velocity, "true_length_scale": truth.length_scale}
    loops = {"compiled": compiled("homotopy") is not None}
    return {"backend": name, **answer, **true, **loops, "faults": wrong}


def faults(backend: Any, problem: RegressionProblem) -> list[str]:
    """Violations of a plug-in's contract on one problem, a sentence each; none where it keeps it.

    Its ``solve`` is pure, returns weights that fit better than zeros do, and says ``ok`` of what
    its certificate confirms only.
    """
    import numpy as np

    from sparsefit.regression.fit import fit

    broken, printed = list[str](), io.StringIO()
    try:
        with redirect_stdout(printed):
            first, second = _solved(backend, problem), _solved(backend, problem)
        if printed.getvalue():
            broken.append(f"it prints: {one_line(printed.getvalue())[:60]!r}")
        weights, again = first.weights, second.weights
        if weights is None or again is None:
            words = "it has no weights for a problem that every least-squares solver solves"
            return [*broken, words]
        if np.linalg.norm(weights - again) > 1e-6 * np.linalg.norm(weights):
            words = "it answers the same problem differently the second time: solve must be pure"
            broken.append(words)
        elif first.status == "ok" and (judged := fit(problem, backend)).status != "ok":
            broken.append(f"it says ok of an answer that is not: {judged.reason}")
        residual = np.linalg.norm(problem.target - problem.design.raw_predict(weights))
        if not residual <= (1.0 + 1e-9) * np.linalg.norm(problem.target):
            broken.append("its weights fit the target worse than zeros do")
    except ModuleNotFoundError as error:
        broken.append(one_line(f"it needs the package {error.name!r}, which is not installed"))
    except Exception as error:  # of code of others, or of what it returned: the last fault
        broken.append(one_line(f"raises {type(error).__name__}: {error}"))
    return broken


def _solved(backend: Backend, problem: RegressionProblem) -> Solution:
    """The solution on copies of the arrays; InputError where the back-end writes into one."""
    arrays = {name: getattr(problem, name) for name in ("theta", "target", "groups")}
    lent = {name: values.copy() for name, values in arrays.items()}
    solution = backend.solve(dataclasses.replace(problem, **lent))
    for name, values in arrays.items():
        if (lent[name] != values).any():
            where = f"writes into problem.{name}, which it is given to read: work on a copy"
            raise InputError(f"back-end {backend.name!r} {where}")
    return solution
