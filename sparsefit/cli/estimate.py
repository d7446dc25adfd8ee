"""`sparsefit estimate`: the flow's parameters from the log of one flight."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.cli.output import duration, print_json
from sparsefit.cli.parser import Verbs, collected, key_value, number, shown, verb, whole

if TYPE_CHECKING:
    from sparsefit.estimator.estimate import Estimate
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.estimator.scales import ScaleEstimate
    from sparsefit.flight import Flight

EXAMPLE = """\
  sparsefit estimate flight.csv
  sparsefit estimate flight.csv --backend lasso --setting alpha_fraction=0.05 --json
  sparsefit estimate flight.csv --estimator estimator.json
  sparsefit estimate flight.csv --scales several --backend gridless-group-lasso
  sparsefit estimate flight.csv --grid-lower 2 --grid-upper 8 --grid-step 0.1
  sparsefit estimate flight.csv --unknown response_time thrust_acceleration

exit code: 0 when the status is ok, 1 when it is not (the estimate is printed all the same),
2 for bad input. `sparsefit backends` lists back-ends and their settings.
"""
OF_ESTIMATOR = (
    "backend",
    "setting",
    "derivative",
    "window",
    "order",
    "grid_lower",
    "grid_upper",
    "grid_step",
    "target",
    "length_scale_readout",
    "mean_velocity_readout",
    "refine",
    "unknown",
    "scales",
)
FINEST = 1e-6  # of a standard error: below it, more digits say nothing
MEANINGS = {
    "duality_gap": "at most this far from the optimum, relative",
    "normal_equations": "relative gradient of the least-squares fit",
    "fixed_point": "share of the support one more step would change",
}


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "estimate",
        run,
        summary="estimate mean velocity, length scale and timescale from a flight",
        example=EXAMPLE,
    )
    parser.add_argument("flight", metavar="FLIGHT", help="flight log, .csv or .parquet")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    _add_estimator(parser)
    vehicle = parser.add_argument_group("vehicle (in place of what the file says)")
    vehicle.add_argument("--response-time", type=number("s"), metavar="S")
    vehicle.add_argument("--thrust-ax", type=number("m/s^2"), metavar="AX", help="in m/s^2")
    vehicle.add_argument("--thrust-ay", type=number("m/s^2"), metavar="AY", help="in m/s^2")


def _add_estimator(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("estimator")
    group.add_argument(
        "--estimator", metavar="FILE", help="estimator.json, as written by sparsefit select"
    )
    group.add_argument("--backend", metavar="NAME", help="default: group-lasso")
    group.add_argument(
        "--setting",
        type=key_value,
        action="append",
        metavar="KEY=VALUE",
        help="setting of the back-end; repeat it for more than one",
    )
    group.add_argument(
        "--derivative",
        metavar="METHOD",
        help="auto (default), forward, central, midpoint, savgol or weak",
    )
    group.add_argument("--window", type=whole, metavar="N", help="of savgol (5 samples) or weak")
    group.add_argument("--order", type=whole, metavar="N", help="of savgol (4) or weak (8)")
    group.add_argument("--grid-lower", type=number("m"), metavar="M", help="default: 1 m")
    group.add_argument("--grid-upper", type=number("m"), metavar="M", help="default: 12 m")
    group.add_argument("--grid-step", type=number("m"), metavar="M", help="default: 0.2 m")
    group.add_argument(
        "--target",
        metavar="NAME",
        help="flow-velocity (default), acceleration or state-derivative",
    )
    group.add_argument(
        "--unknown",
        nargs="+",
        metavar="NAME",
        help="estimated with the flow: response_time, thrust_acceleration, wind",
    )
    group.add_argument(
        "--length-scale-readout",
        metavar="NAME",
        help="group-norm (default), absolute-sum or signed-sum",
    )
    group.add_argument(
        "--mean-velocity-readout", metavar="NAME", help="rms (default), peak or paper"
    )
    group.add_argument(
        "--refine",
        metavar="NAME",
        help="variable-projection (default: L off the grid) or none (the candidate itself)",
    )
    group.add_argument(
        "--scales",
        metavar="NAME",
        help="one (default) or several: all cellular flows that are superposed, as the back-end "
        "proposes them",
    )


def run(args: argparse.Namespace) -> int:
    """Estimate, print, and tell by the exit code whether the status is ok."""
    estimator = _estimator(args)
    flight = _flight(args, estimator.library.unknown)
    estimate = estimator.estimate(flight)
    if args.json:
        print_json(estimate.to_dict())
    else:
        unknown = estimator.library.unknown
        print("\n".join(_lines(args.flight, flight, estimate, unknown)))
    if estimate.status != "ok":
        print(f"sparsefit: {estimate.status}: {estimate.reason}", file=sys.stderr)
    return 0 if estimate.status == "ok" else 1


def _estimator(args: argparse.Namespace) -> Estimator:
    from sparsefit.errors import InputError

    given = [name for name in OF_ESTIMATOR if getattr(args, name) is not None]
    if args.estimator is None:
        return _built(args)
    if given:
        option = "--" + given[0].replace("_", "-")
        raise InputError(f"{option} and --estimator cannot both be given; drop one")
    return _read_estimator(args.estimator)


def _built(args: argparse.Namespace) -> Estimator:
    from sparsefit import backends
    from sparsefit.derivative import Derivative
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.library.builder import Library
    from sparsefit.library.grid import LengthScaleGrid
    from sparsefit.modes.readout import Readout

    # A window or an order is one of savgol: the automatic choice has none to be told.
    told = args.window is not None or args.order is not None
    method = args.derivative or ("savgol" if told else None)
    grid = LengthScaleGrid(
        **_given(lower=args.grid_lower, upper=args.grid_upper, step=args.grid_step)
    )
    return Estimator(
        Derivative(**_given(method=method, window=args.window, order=args.order)),
        Library(**_given(grid=grid, target=args.target, unknown=args.unknown)),
        backends.get(args.backend or "group-lasso", **collected(args.setting or ())),
        Readout(
            **_given(
                length_scale=args.length_scale_readout,
                mean_velocity=args.mean_velocity_readout,
                refine=args.refine,
                scales=args.scales,
            )
        ),
    )


def _given(**options: Any) -> dict[str, Any]:
    """Options that were given; for the others the defaults of the records hold."""
    return {name: value for name, value in options.items() if value is not None}


def _read_estimator(path: str) -> Estimator:
    from sparsefit.errors import InputError
    from sparsefit.estimator.estimator import Estimator

    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; give a file of sparsefit select") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; check the path") from None
    try:
        return Estimator.from_json(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _flight(args: argparse.Namespace, unknown: tuple[str, ...]) -> Flight:
    """The flight, its vehicle as in the file unless the command line says otherwise."""
    from sparsefit.errors import InputError
    from sparsefit.flight import read_flight
    from sparsefit.flight.files import FORMATS
    from sparsefit.flight.vehicle import PointMassVehicle

    given = _given(
        response_time=args.response_time, thrust_ax=args.thrust_ax, thrust_ay=args.thrust_ay
    )
    # Its value is no part of the answer, but the record of a flight has one.
    sought = "response_time" in unknown
    if not given and not sought:
        try:
            return read_flight(args.flight)
        except InputError as error:
            remedy = "give --response-time"
            raise InputError(str(error).replace("pass vehicle=", remedy)) from None
    read_flight(args.flight, vehicle=PointMassVehicle(1.0))  # refuses all but a missing vehicle
    path = Path(args.flight)
    vehicle = {**FORMATS[path.suffix.lower()].decode(path.read_bytes()).settings, **given}
    if sought:
        vehicle.setdefault("response_time", 1.0)
    if "response_time" not in vehicle:
        raise InputError(f"{path}: no vehicle: the file has none; give --response-time too")
    thrust = (vehicle.get("thrust_ax", 0.0), vehicle.get("thrust_ay", 0.0))
    return read_flight(path, vehicle=PointMassVehicle(vehicle["response_time"], thrust))


def _lines(name: str, flight: Flight, estimate: Estimate, unknown: tuple[str, ...]) -> list[str]:
    ax, ay = flight.vehicle.thrust_acceleration
    known = {
        "response_time": f"response time {flight.vehicle.response_time:g} s",
        "thrust_acceleration": f"thrust ({ax:g}, {ay:g}) m/s^2",
    }
    vehicle = [words for key, words in known.items() if key not in unknown]
    certificate = estimate.certificate
    proof = f"{certificate.kind} {certificate.value:.1e}" if certificate else "none"
    meaning = (
        f"  ({MEANINGS[certificate.kind]})" if certificate and certificate.kind in MEANINGS else ""
    )
    rows = [
        ("flight", f"{name}: {flight.samples} samples over {flight.duration:g} s"),
        ("vehicle", ", ".join(vehicle) or "unknown"),
        ("", ""),
        *_parameters(estimate),
        *_estimated(estimate),
        ("", ""),
        *_scales(estimate),
        ("status", estimate.status + (f": {estimate.reason}" if estimate.reason else "")),
        ("back-end", f"{estimate.backend}  {shown(estimate.settings)}".rstrip()),
        ("certificate", proof + meaning),
        ("problem", f"{estimate.samples} samples x {estimate.columns} columns"),
        ("time", duration(estimate.seconds)),
    ]
    return [f"{label:<20}  {value}".rstrip() for label, value in rows]


def _estimated(estimate: Estimate) -> list[tuple[str, str]]:
    """What was unknown beside the flow."""
    rows, known = [], estimate.vehicle_uncertainty
    if estimate.response_time == estimate.response_time:
        given = (known.response_time, known.response_time_interval) if known else ()
        rows.append(("response time  tau", _quantity(estimate.response_time, "s", *given)))
    for label, name, unit in (
        ("thrust         a", "thrust_acceleration", "m/s^2"),
        ("wind", "wind", "m/s"),
    ):
        pair = getattr(estimate, name)
        if pair is not None:
            words = f"({pair[0]:.4f}, {pair[1]:.4f}) {unit}"
            rows.append((label, words + _spread(getattr(known, name) if known else None)))
    return rows


def _spread(pair: tuple[float, float] | None) -> str:
    """Standard errors of a pair, to two digits and four decimals at least."""
    if pair is None:
        return ""
    if not all(map(math.isfinite, pair)):
        return "  ± unknown"
    if min(pair) < FINEST:
        return f"  ± ({pair[0]:.1e}, {pair[1]:.1e})"
    places = max(4, 1 - math.floor(math.log10(min(pair))))
    return f"  ± ({pair[0]:.{places}f}, {pair[1]:.{places}f})"


def _scales(estimate: Estimate) -> list[tuple[str, str]]:
    """A line per cellular flow where several were asked for, fastest first."""
    if not estimate.scales:
        return []
    head = f"{'U0 [m/s]':>9} {'L_w [m]':>9} {'tau_w [s]':>9}"
    if all(one.uncertainty is not None for one in estimate.scales):
        head = f"{'U0 [m/s]':>9} {'±':<8} {'L_w [m]':>9} {'±':<8} {'tau_w [s]':>9} ±"
    rows = [(f"  {i}", _flow(one)) for i, one in enumerate(estimate.scales, start=1)]
    return [(f"cellular flows  {len(rows)}", head), *rows, ("", "")]


def _flow(one: ScaleEstimate) -> str:
    """U0, L_w and tau_w of one cellular flow, each with its standard error where it is known."""
    cells = []
    for name in ("mean_velocity", "length_scale", "timescale"):
        cells.append(f"{getattr(one, name):>9.4f}")
        if one.uncertainty is not None:
            cells.append(f"{_short(getattr(one.uncertainty, name)):<8}")
    return " ".join(cells).rstrip()


def _short(spread: float) -> str:
    """A standard error in a column of a table."""
    if not math.isfinite(spread):
        return "unknown"
    return f"{spread:.4f}" if spread >= 1e-4 else f"{spread:.1e}"


def _parameters(estimate: Estimate) -> list[tuple[str, str]]:
    """U0, L_w and tau_w, each with its standard error and 95 % interval where they are known."""
    known, rows = estimate.uncertainty, []
    for label, name, unit in (
        ("mean velocity  U0", "mean_velocity", "m/s"),
        ("length scale   L_w", "length_scale", "m"),
        ("timescale      tau_w", "timescale", "s"),
    ):
        value = getattr(estimate, name)
        if known is None:
            rows.append((label, _quantity(value, unit)))
        else:
            spread, ends = getattr(known, name), getattr(known, f"{name}_interval")
            rows.append((label, _quantity(value, unit, spread, ends)))
    return rows


def _quantity(
    value: float, unit: str, spread: float | None = None, ends: tuple[float, float] = (0.0, 0.0)
) -> str:
    """A value to two digits of its standard error, four decimals at least."""
    if value != value:
        return f"{'–':>9} {unit}"
    if spread is None:
        return f"{value:>9.4f} {unit}"
    if not math.isfinite(spread):
        return f"{value:>9.4f} {unit:<3}  ± unknown"
    if spread < FINEST:
        return f"{value:>9.4f} {unit:<3}  ± {spread:.1e}"
    places = max(4, 1 - math.floor(math.log10(spread)))
    low, high = (f"{end:.{places}f}" for end in ends)
    return f"{value:>9.{places}f} {unit:<3}  ± {spread:.{places}f}  (95 %: {low} … {high})"
