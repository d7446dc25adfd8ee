"""`sparsefit estimate`: the flow's parameters from the log of a flight, or of several."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import FORCE, PAIRS, SETTING, Option, Verbs, key_value, verb
from sparsefit.cli.terminal import Reply, check_output
from sparsefit.errors import InputError, one_line, told_with
from sparsefit.whole_file import write_whole

if TYPE_CHECKING:
    from sparsefit.cli.printed import ReadLog
    from sparsefit.estimator import Estimator
    from sparsefit.logs.flight_table import FlightTable

FLIGHT = Option(
    "flight", "flight log: a table (.csv, .parquet; .txt, .tsv, .dat), .ulg of PX4, .igc of a "
    "glider; several are flights through one flow, in one frame and by one clock", "FLIGHT",
    nargs="+",
)  # fmt: skip
PLOT = Option("--plot", "draw track, cells, weights and residual: .png, .svg or .pdf", "FILE")
LOG = (
    Option("--columns", "columns of a foreign table and their units: time=t[ms],x=lon,y=lat,"
           "vx=u[cm/s],vy=v[cm/s]; without a unit s, m and m/s, and degrees of lon... and lat...",
           "MAP"),
    Option("--from", "time from which the log is read", "s", float, dest="begin"),
    Option("--to", "time up to which the log is read", "s", float, dest="end"),
    Option("--longest-gap", "longest gap that is accepted; default: 60 s, or 20 steps", "s",
           float),
)  # fmt: skip
VEHICLE = {  # the setting of a flight file that an option replaces
    "response_time": Option(
        "--response-time", "response time of linear drag; alone: no quadratic drag", "s", float),
    "drag": Option("--drag", "quadratic drag; alone: no linear drag", "1/m", float),
    "thrust_ax": Option("--thrust-ax", "thrust along x", "m/s^2", float),
    "thrust_ay": Option("--thrust-ay", "thrust along y", "m/s^2", float),
    "thrust_scale": Option("--thrust-scale", "factor of the logged thrust ax, ay", "NUMBER", float),
}  # fmt: skip

ESTIMATOR = {  # the dotted key of an estimator: the option that sets it
    "library.lower": Option(
        "--grid-lower", "smallest length scale; default: 1 m", "m", float),
    "library.upper": Option("--grid-upper", "largest length scale; default: 12 m", "m", float),
    "library.step": Option("--grid-step", "step of the grid; default: 0.2 m", "m", float),
    "library.unknown": Option(
        "--unknown", "parameters of the vehicle to estimate: response_time, drag, thrust_scale, "
        "thrust_acceleration, wind", "NAME", nargs="+"),
    "free": Option(
        "--free", "causes of a misfit to estimate: latency, velocity_scale, lag ...; "
        "auto: all that are found", "NAME", nargs="+"),
    "backend.name": Option(
        "--backend", "back-end that selects the candidates; default: group-lasso", "NAME"),
}  # fmt: skip
SET = Option(
    "--set", "any other key of [derivative], [library] or [readout] of a study file, as "
    "library.family=waves; repeat it for more than one", "SECTION.KEY=VALUE", key_value, **PAIRS,
)  # fmt: skip
ALL = (
    Option("--estimator", "estimator.json, as written by sparsefit select", "FILE"),
    *ESTIMATOR.values(), SETTING, SET,
)  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    vehicle = {"vehicle (in place of what the file says)": VEHICLE.values()}
    groups = {"log": LOG, "estimator": ALL, **vehicle}
    verb(verbs, "estimate", run, (FLIGHT, PLOT, FORCE), groups)


def run(args: argparse.Namespace) -> Reply:
    """Estimate mean velocity, length scale and timescale from a flight, or several.

    example:
      sparsefit estimate flight.csv
      sparsefit estimate monday.csv tuesday.csv
      sparsefit estimate flight.csv --backend lasso --setting alpha_fraction=0.05 --json
      sparsefit estimate flight.csv --estimator estimator.json
      sparsefit estimate flight.csv --set readout.scales=several
      sparsefit estimate flight.csv --set library.family=waves --grid-lower 3 --json
      sparsefit estimate flight.csv --unknown response_time thrust_acceleration
      sparsefit estimate flight.csv --plot flight.svg
      sparsefit estimate log.ulg --unknown response_time --from 60 --to 300
      sparsefit estimate a.igc --response-time 2 --grid-lower 100 --grid-upper 2000 --grid-step 20
      sparsefit estimate a.csv --response-time 60 --columns "time=t,x=lon,y=lat,vx=u[cm/s],vy=v"

    exit code: 0 when the status is ok, 1 when it is not (the estimate is printed all the same),
    2 for bad input. `sparsefit backends` lists back-ends and their settings.
    """
    from sparsefit.cli.printed import lines

    if args.plot is not None:
        check_output(args.plot, force=args.force, endings=(".png", ".svg", ".pdf"))
    estimator = estimator_of(args)
    logs = _logs(args, estimator)
    flights = [log.flight for log in logs]
    estimate = estimator.estimate(flights[0] if len(flights) == 1 else flights)
    if args.plot is not None:  # all tracks, and the residual of the first flight
        from sparsefit.plot import draw_estimate, encoded

        more = f" and {len(flights) - 1} more" if len(flights) > 1 else ""
        title = f"{one_line(args.flight[0])}{more}"
        figure = draw_estimate(estimate, estimator, flights, title)
        write_whole(args.plot, encoded(figure, Path(args.plot).suffix.lower()))
    records = [log.record() for log in logs]
    read = {"log": records[0]} if len(logs) == 1 else {"logs": records}
    answer = lines(logs, estimate, estimator.library.unknown)
    return Reply(estimate.to_dict() | read, answer, int(estimate.status != "ok"))


def _logs(args: argparse.Namespace, estimator: Estimator) -> list[ReadLog]:
    """The logs, cut to the times asked for, in the frame of the first; bad ones are refused.

    A vehicle is as in the file unless the command line says otherwise.
    """
    from sparsefit.cli.printed import ReadLog
    from sparsefit.logs.checks import LogQuality, check_log
    from sparsefit.logs.files import read_table
    from sparsefit.logs.flight_table import vehicle_of
    from sparsefit.logs.layout import Layout
    from sparsefit.rows import Derivative

    tables: list[FlightTable] = []
    for path in args.flight:
        zeros = (tables[0].origin, tables[0].epoch) if tables else ()
        tables.append(read_table(path, Layout.of(args.columns, *zeros)))
    placed = [table.origin is not None for table in tables]
    if any(placed) and not all(placed):
        where, nowhere = args.flight[placed.index(True)], args.flight[placed.index(False)]
        raise InputError(
            f"{nowhere}: has no longitude and latitude, and {where} has: several "
            "flights need one frame; give x and y of all in metres about one place"
        )
    logs, grid, unknown = [], estimator.library.grid, estimator.library.unknown
    given = {name: getattr(args, name) for name in VEHICLE if getattr(args, name) is not None}
    for path, table in zip(args.flight, tables, strict=True):
        settings = dict(table.settings) | given
        for law, other in (("response_time", "drag"), ("drag", "response_time")):
            if law in given and other not in given:
                settings.pop(other, None)
            if law in unknown and law not in settings:  # a flight needs one, that nothing reads
                settings = {k: v for k, v in settings.items() if k != other} | {law: 1.0}
        with told_with(path):
            flight = table.flight(vehicle_of(settings))
            begin = flight.time[0] if args.begin is None else args.begin
            end = flight.time[-1] if args.end is None else args.end
            flight = flight.rows((flight.time >= begin) & (flight.time <= end))
            check_log(flight, smallest=grid.lower, largest=grid.upper, longest_gap=args.longest_gap)
        quality = LogQuality(flight, Derivative()(flight).smoothing)
        logs.append(ReadLog(path, flight, quality, table.notes))
    return logs


def estimator_of(args: argparse.Namespace) -> Estimator:
    """The estimator of the options, or of the file that `--estimator` names.

    Raises:
        InputError: with the option, or with the file and its key, that is wrong.
    """
    from sparsefit.codec import Place
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.estimator.saved import parts_of
    from sparsefit.model import LengthScaleGrid

    given = [option for option in ALL[1:] if getattr(args, option.dest) not in (None, [])]
    if args.estimator is not None:
        if given:
            first = given[0].names[0]
            raise InputError(f"{first} and --estimator cannot both be given; drop one")
        return read_estimator(args.estimator)
    values = {key: getattr(args, item.dest) for key, item in ESTIMATOR.items() if item in given}
    values |= {f"backend.{key}": value for key, value in args.setting} | dict(args.set)

    class TypedPlace(Place):
        def error(self, problem: str) -> InputError:
            key = f"{self.section}.{self.key}".strip(".").replace("library.grid.", "library.")
            option = ESTIMATOR[key].names[0] if key in ESTIMATOR else f"--set {key}"
            return InputError(f"{option} {problem}" if self.key else problem)

    record: dict[str, Any] = {"library": {}, "backend": {"name": "group-lasso"}}
    grid: dict[str, Any] = {}
    for dotted, value in values.items():
        section, _, key = dotted.rpartition(".")
        of_grid = section == "library" and hasattr(LengthScaleGrid, key)
        place = grid if of_grid else record.setdefault(section, {}) if section else record
        place[key] = value
    record["library"]["grid"] = grid
    return Estimator(**parts_of(record, TypedPlace("")))


def read_estimator(path: str) -> Estimator:
    """The estimator of a file. Raises InputError with the name of the file on anything else."""
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.whole_file import read_whole

    text = read_whole(path, most=16_000_000).decode(errors="replace")
    with told_with(path):
        return Estimator.from_json(text)
