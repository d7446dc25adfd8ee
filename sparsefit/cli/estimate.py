"""`sparsefit estimate`: the flow's parameters from the log of a flight, or of several."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from sparsefit.cli.estimate_log import Log, add_log, quality_of_log, read_logs, refuse_frames
from sparsefit.cli.estimate_plot import add_plot, check_plot, write_plot
from sparsefit.cli.estimator_options import add_estimator, estimator_of
from sparsefit.cli.output import print_json
from sparsefit.cli.parser import Verbs, number, verb
from sparsefit.errors import InputError, told_with

if TYPE_CHECKING:
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.flight import Flight
    from sparsefit.logs.table import FlightTable

EXAMPLE = """\
  sparsefit estimate flight.csv
  sparsefit estimate monday.csv tuesday.csv
  sparsefit estimate flight.csv --backend lasso --setting alpha_fraction=0.05 --json
  sparsefit estimate flight.csv --estimator estimator.json
  sparsefit estimate flight.csv --scales several --backend gridless-group-lasso
  sparsefit estimate flight.csv --grid-lower 2 --grid-upper 8 --grid-step 0.1
  sparsefit estimate flight.csv --family waves --grid-lower 3 --json
  sparsefit estimate flight.csv --unknown response_time thrust_acceleration
  sparsefit estimate flight.csv --plot flight.svg
  sparsefit estimate log.ulg --unknown response_time --from 60 --to 300
  sparsefit estimate glider.igc --response-time 2 --grid-lower 100 --grid-upper 2000 --grid-step 20
  sparsefit estimate drifters.csv --only id=7 --columns "time=t,x=lon,y=lat,vx=u[cm/s],vy=v[cm/s]"

exit code: 0 when the status is ok, 1 when it is not (the estimate is printed all the same),
2 for bad input. `sparsefit backends` lists back-ends and their settings.
"""
VEHICLE = {  # settings of a flight file; their unit, and what --help says of them
    "response_time": ("s", "S", "of linear drag; alone: no quadratic drag"),
    "drag": ("1/m", "1/M", "quadratic drag; alone: no linear drag"),
    "thrust_ax": ("m/s^2", "AX", "thrust along x in m/s^2"),
    "thrust_ay": ("m/s^2", "AY", "thrust along y in m/s^2"),
    "thrust_scale": ("", "S", "of the measured thrust ax, ay"),
}
STAND_IN = 1.0  # s or 1/m; where the drag is sought, a flight needs one that nothing reads


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "estimate",
        run,
        summary="estimate mean velocity, length scale and timescale from a flight, or several",
        example=EXAMPLE,
    )
    parser.add_argument(
        "flight",
        metavar="FLIGHT",
        nargs="+",
        help="flight log: a table (.csv, .parquet; .txt, .tsv, .dat), .ulg of PX4, .igc of a "
        "glider; several are flights through one flow, in one frame and by one clock",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_plot(parser)
    add_log(parser)
    add_estimator(parser)
    vehicle = parser.add_argument_group("vehicle (in place of what the file says)")
    for name, (unit, metavar, text) in VEHICLE.items():
        option = f"--{name.replace('_', '-')}"
        vehicle.add_argument(option, type=number(unit), metavar=metavar, help=text)


def run(args: argparse.Namespace) -> int:
    """Estimate, print, and tell by the exit code whether the status is ok."""
    from sparsefit.cli.estimate_lines import lines

    check_plot(args)
    estimator = estimator_of(args)
    tables = read_logs(args)
    refuse_frames(args.flight, tables)
    read = zip(args.flight, tables, strict=True)
    logs = [_log(args, path, table, estimator) for path, table in read]
    flights = [log.flight for log in logs]
    estimate = estimator.estimate(flights[0] if len(flights) == 1 else flights)
    if args.plot is not None:
        write_plot(args.plot, args.flight, estimator, flights, estimate)
    if args.json:
        records = [log.record(estimate) for log in logs]
        told = {"log": records[0]} if len(logs) == 1 else {"logs": records}
        print_json(estimate.to_dict() | told)
    else:
        print("\n".join(lines(logs, estimate, estimator.library.unknown)))
    if estimate.status != "ok" and not sys.stdout.isatty():  # there it has just been read
        print(f"sparsefit: {estimate.status}: {estimate.reason}", file=sys.stderr)
    return 0 if estimate.status == "ok" else 1


def _log(args: argparse.Namespace, path: str, table: FlightTable, estimator: Estimator) -> Log:
    """One log, its quality looked at."""
    flight = _flight(args, path, table, estimator.library.unknown)
    quality = quality_of_log(args, path, flight, estimator.library.grid)
    return Log(path, flight, quality, table.notes)


def _flight(
    args: argparse.Namespace, path: str, table: FlightTable, unknown: tuple[str, ...]
) -> Flight:
    """The flight, its vehicle as in the file unless the command line says otherwise."""
    from sparsefit.logs.table import vehicle_of

    given = {name: getattr(args, name) for name in VEHICLE if getattr(args, name) is not None}
    settings = table.settings | given
    for law, other in (("response_time", "drag"), ("drag", "response_time")):
        if law in given and other not in given:
            settings.pop(other, None)
        if law in unknown and law not in settings:
            settings = {k: v for k, v in settings.items() if k != other} | {law: STAND_IN}
    if "response_time" not in settings and "drag" not in settings:
        told = "the file has no `# response_time=` line; add it or give --response-time"
        if given:
            told = "the file has none; give --response-time too"
        elif table.notes:  # no line of ours can be added to a log of others
            told = "the log does not tell; give --response-time, or --unknown response_time"
        raise InputError(f"{path}: no vehicle: {told}")
    vehicle = vehicle_of(settings)
    with told_with(path):
        return table.flight(vehicle)
