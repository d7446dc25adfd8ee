"""`sparsefit estimate`: the flow's parameters from the log of a flight, or of several."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from sparsefit.cli.estimate_lines import lines
from sparsefit.cli.estimate_log import Log, add_log, quality_of_log, read_logs, refuse_frames
from sparsefit.cli.estimate_plot import add_plot, check_plot, write_plot
from sparsefit.cli.output import print_json
from sparsefit.cli.parser import Verbs, add_setting, collected, number, verb, whole

if TYPE_CHECKING:
    from sparsefit.codec import Place
    from sparsefit.errors import InputError
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.flight import Flight
    from sparsefit.flight.table import FlightTable

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
# Where the value of an option stands in an estimator's record.
OPTIONS = {
    "derivative": ("derivative", "method"),
    "window": ("derivative", "window"),
    "order": ("derivative", "order"),
    "no_repair": ("derivative", "repair"),
    "grid_lower": ("library.grid", "lower"),
    "grid_upper": ("library.grid", "upper"),
    "grid_step": ("library.grid", "step"),
    "family": ("library", "family"),
    "groups": ("library", "groups"),
    "target": ("library", "target"),
    "unknown": ("library", "unknown"),
    "backend": ("backend", "name"),
    "setting": ("backend", ""),
    "length_scale_readout": ("readout", "length_scale"),
    "mean_velocity_readout": ("readout", "mean_velocity"),
    "refine": ("readout", "refine"),
    "scales": ("readout", "scales"),
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
    _add_estimator(parser)
    vehicle = parser.add_argument_group("vehicle (in place of what the file says)")
    vehicle.add_argument(
        "--response-time",
        type=number("s"),
        metavar="S",
        help="of linear drag; alone: no quadratic drag",
    )
    vehicle.add_argument(
        "--drag", type=number("1/m"), metavar="1/M", help="quadratic drag; alone: no linear drag"
    )
    vehicle.add_argument(
        "--thrust-ax", type=number("m/s^2"), metavar="AX", help="thrust along x in m/s^2"
    )
    vehicle.add_argument(
        "--thrust-ay", type=number("m/s^2"), metavar="AY", help="thrust along y in m/s^2"
    )
    vehicle.add_argument(
        "--thrust-scale", type=number(), metavar="S", help="of the measured thrust ax, ay"
    )


def _add_estimator(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("estimator")
    group.add_argument(
        "--estimator", metavar="FILE", help="estimator.json, as written by sparsefit select"
    )
    group.add_argument(
        "--backend", metavar="NAME", help="that picks the candidates; default: group-lasso"
    )
    add_setting(group)
    group.add_argument(
        "--derivative",
        metavar="METHOD",
        help="auto (default), forward, central, midpoint, savgol or weak",
    )
    group.add_argument("--window", type=whole, metavar="N", help="of savgol (5 samples) or weak")
    group.add_argument("--order", type=whole, metavar="N", help="of savgol (4) or weak (8)")
    group.add_argument(
        "--no-repair",
        action="store_false",
        default=None,
        help="leave outliers, jumps, gaps, uneven and repeated samples as they are",
    )
    group.add_argument(
        "--grid-lower",
        type=number("m"),
        metavar="M",
        help="least length scale sought; default: 1 m",
    )
    group.add_argument(
        "--grid-upper", type=number("m"), metavar="M", help="largest one; default: 12 m"
    )
    group.add_argument(
        "--grid-step", type=number("m"), metavar="M", help="between candidates; default: 0.2 m"
    )
    group.add_argument(
        "--family", metavar="NAME", help="of the library: cells (default), stream or waves"
    )
    group.add_argument("--groups", metavar="NAME", help="of waves: wave (default), ring or nested")
    group.add_argument(
        "--target",
        metavar="NAME",
        help="flow-velocity (default), acceleration or state-derivative",
    )
    group.add_argument(
        "--unknown",
        nargs="+",
        metavar="NAME",
        help="estimated with the flow: response_time, drag, thrust_scale, thrust_acceleration, "
        "wind",
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
        help="ladder (default: off the grid, with shape, heading and drift), variable-projection "
        "(off the grid, steady square cells along the axes only) or none (the candidate itself)",
    )
    group.add_argument(
        "--scales",
        metavar="NAME",
        help="one (default) or several: all cellular flows that are superposed, as the back-end "
        "proposes them",
    )


def run(args: argparse.Namespace) -> int:
    """Estimate, print, and tell by the exit code whether the status is ok."""
    check_plot(args)
    estimator = _estimator(args)
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


def _estimator(args: argparse.Namespace) -> Estimator:
    from sparsefit.errors import InputError

    given = [name for name in OPTIONS if getattr(args, name) is not None]
    if args.estimator is None:
        return _built(args, given)
    if given:
        raise InputError(f"{_typed(given[0])} and --estimator cannot both be given; drop one")
    return read_estimator(args.estimator)


def _built(args: argparse.Namespace, given: list[str]) -> Estimator:
    """The estimator of the options that were given; for the others its defaults hold."""
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.estimator.saved import parts_of

    values = {OPTIONS[name]: getattr(args, name) for name in given if name != "setting"}
    # A window or an order is one of savgol: the automatic choice has none to be told.
    if not {"window", "order"}.isdisjoint(given):
        values.setdefault(("derivative", "method"), "savgol")
    record: dict[str, dict[str, object]] = {"library": {}, "backend": {"name": "group-lasso"}}
    for (section, key), value in values.items():
        record.setdefault(section, {})[key] = value
    record["library"]["grid"] = record.pop("library.grid", {})
    record["backend"] |= collected(args.setting)
    return Estimator(**parts_of(record, _place()))


def _place() -> Place:
    """Where a value stands on the command line: the option that gave it."""
    from sparsefit.codec import Place
    from sparsefit.errors import InputError

    class Option(Place):
        def error(self, problem: str) -> InputError:
            names = {place: name for name, place in OPTIONS.items()}
            name = names.get((self.section, self.key))
            return InputError(f"{_typed(name)} {problem}" if name else problem)

    return Option("")


def _typed(option: str) -> str:
    return "--" + option.replace("_", "-")


LONGEST = 16_000_000  # bytes of an estimator file


def read_estimator(path: str) -> Estimator:
    """The estimator of a file. Raises InputError, which names the file, on anything else."""
    from sparsefit.errors import InputError, told_with
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.whole_file import read_whole

    try:
        text = read_whole(path, most=LONGEST).decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; give a file of sparsefit select") from None
    with told_with(path):
        return Estimator.from_json(text)


def _flight(
    args: argparse.Namespace, path: str, table: FlightTable, unknown: tuple[str, ...]
) -> Flight:
    """The flight, its vehicle as in the file unless the command line says otherwise."""
    from sparsefit.errors import InputError, told_with
    from sparsefit.flight.table import vehicle_of

    names = ("response_time", "drag", "thrust_ax", "thrust_ay", "thrust_scale")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
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
