"""`sparsefit backends`: what can be chosen, and whether it works here."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from sparsefit.cli.output import duration, print_json, proof
from sparsefit.cli.parser import Verbs, add_setting, collected, shown, verb

EXAMPLE = """\
  sparsefit backends
  sparsefit backends check group-lasso --setting solver=clarabel
"""


def add(verbs: Verbs) -> None:
    """Declare the verb; without an action it lists."""
    parser = verb(
        verbs,
        "backends",
        run_list,
        summary="list the back-ends with their settings, or check that one works",
        example=EXAMPLE,
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    actions = parser.add_subparsers(metavar="ACTION", title="actions")
    listing = verb(
        actions,
        "list",
        run_list,
        summary="list the back-ends, plug-ins included, with their settings and defaults",
        example="  sparsefit backends list --json\n",
    )
    check = verb(
        actions,
        "check",
        run_check,
        summary="run a back-end on a small flight whose answer is known",
        example="  sparsefit backends check lasso --setting solver=osqp\n",
    )
    check.add_argument("name", metavar="NAME", help="a back-end, see sparsefit backends list")
    add_setting(check)
    for action in (listing, check):
        # Not to undo a --json that stands before the action.
        action.add_argument(
            "--json", action="store_true", default=argparse.SUPPRESS, help="print JSON"
        )


def run_list(args: argparse.Namespace) -> int:
    """List every back-end; one that is broken with its error."""
    from sparsefit import backends
    from sparsefit.backends.conic import installed_solvers

    records = [_record(name) for name in backends.known()]
    solvers = installed_solvers()
    if args.json:
        print_json({"backends": records, "cvxpy_solvers": solvers})
        return 0
    print("\n\n".join(_entry(record) for record in records))
    print(f"\nsolvers that cvxpy finds here: {', '.join(solvers)}")
    return 0


def _record(name: str) -> dict[str, Any]:
    from sparsefit import backends
    from sparsefit.errors import InputError

    try:
        loaded = backends.load(name)
        settings = backends.settings_of(backends.get(name))
    except (InputError, TypeError) as error:  # a plug-in whose settings have no defaults
        return {"name": name, "error": " ".join(str(error).split())}
    # Each of our own is a module of its own, whose first line says more than its class's.
    described = sys.modules[loaded.__module__] if name in backends.BACKENDS else loaded
    summary = (described.__doc__ or "").strip().split("\n\n")[0]
    return {
        "name": name,
        "summary": " ".join(summary.split()),
        "certificate": loaded.certificate_kind,
        "settings": settings,
    }


def _entry(record: dict[str, Any]) -> str:
    if "error" in record:
        return f"{record['name']}\n  broken: {record['error']}"
    settings = shown(record["settings"]) or "none"
    return (
        f"{record['name']}\n  {record['summary']}\n"
        f"  certificate: {record['certificate']}\n  settings: {settings}"
    )


def run_check(args: argparse.Namespace) -> int:
    """Exit 0 only if the back-end's answer is certified."""
    from sparsefit import backends
    from sparsefit.backends.conic import installed_solvers
    from sparsefit.backends.loops import loop_of
    from sparsefit.derivative import Derivative
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.flight import simulate_flight
    from sparsefit.flight.flow import CellularFlow
    from sparsefit.flight.vehicle import PointMassVehicle
    from sparsefit.library.builder import Library
    from sparsefit.library.grid import LengthScaleGrid
    from sparsefit.regression.statistics import product_loop

    backend = backends.get(args.name, **collected(args.setting))
    truth = CellularFlow(mean_velocity=15.0, length_scale=4.0)
    flight = simulate_flight(
        truth, PointMassVehicle(0.5, (5.0, 3.0)), duration=10.0, sample_rate=50.0, seed=7
    )
    library = Library(LengthScaleGrid(3.0, 5.0, 1.0))
    estimate = Estimator(Derivative(), library, backend).estimate(flight)
    if args.json:
        machinery = {
            "loop": loop_of(args.name),
            "gram": product_loop(),
            "cvxpy_solvers": installed_solvers(),
        }
        print_json({**estimate.to_dict(), **machinery})
    else:
        reason = f" ({estimate.reason})" if estimate.reason else ""
        print(
            f"{args.name}: {estimate.status}{reason}, certificate {proof(estimate.certificate)}, "
            f"{duration(estimate.seconds)}\n"
            f"  settings: {shown(estimate.settings) or 'none'}\n"
            f"  loop: {loop_of(args.name) or 'no compiled one'}, Gram matrix: {product_loop()}\n"
            f"  estimate: {estimate.mean_velocity:.2f} m/s, {estimate.length_scale:.2f} m "
            f"(truth: {truth.mean_velocity:.2f} m/s, {truth.length_scale:.2f} m)\n"
            f"  solvers that cvxpy finds here: {', '.join(installed_solvers())}"
        )
    return 0 if estimate.status == "ok" else 1
