"""`sparsefit simulate`: fly a simulated vehicle and write what it logs."""

from __future__ import annotations

import argparse
import sys

from sparsefit.cli.output import check_output
from sparsefit.cli.parser import Verbs, number, verb, whole
from sparsefit.cli.simulated import add_faults, add_flow, faults_of, flow_of, vehicle_of
from sparsefit.errors import one_line

EXAMPLE = """\
  sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 --response-time 0.5 \\
      --thrust 5 3 --duration 10 --sample-rate 100 --seed 7 -o flight.csv
  sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 --heading 0.3 --drift 1 0.5 \\
      --turbulence 1.5 8 --outliers 0.01 5 -o windy.csv
  sparsefit simulate --mean-velocity 8 --length-scale 4 --drag 0.3 -o drag.csv
  sparsefit simulate --mean-velocity 8 --length-scale 4 --thrust-turn 6 5 -o circling.csv
"""
MANY = 100_000  # samples: beyond them a flight takes long enough to be told of
FAULTY = 100  # the child of the seed that faults are drawn from, as in a study


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "simulate",
        run,
        summary="simulate a flight through cells, in turbulence too, and write it to a file",
        example=EXAMPLE,
    )
    add_flow(parser)
    craft = parser.add_argument_group("vehicle")
    craft.add_argument(
        "--response-time",
        type=number("s"),
        metavar="S",
        help="of linear drag; default: 0.5 s, with --drag none",
    )
    craft.add_argument(
        "--drag", type=number("1/m"), default=0.0, metavar="1/M", help="quadratic drag; default: 0"
    )
    craft.add_argument(
        "--thrust",
        type=number("m/s^2"),
        nargs=2,
        default=(5.0, 3.0),
        metavar=("AX", "AY"),
        help="thrust acceleration; default: 5 3 m/s^2",
    )
    craft.add_argument(
        "--thrust-turn",
        type=number(),
        nargs=2,
        metavar=("A", "S"),
        help="thrust in m/s^2 that turns once in so many seconds, beside --thrust; it is logged",
    )
    craft.add_argument(
        "--thrust-noise",
        type=number("m/s^2"),
        default=0.0,
        metavar="A",
        help="standard deviation of the logged thrust; default: 0",
    )
    _add_log(parser)
    add_faults(parser)
    parser.add_argument(
        "-o", "--output", required=True, metavar="FILE", help="flight to write, .csv or .parquet"
    )
    parser.add_argument("--force", action="store_true", help="overwrite FILE")


def _add_log(parser: argparse.ArgumentParser) -> None:
    log = parser.add_argument_group("flight")
    for option, unit, default, text in (
        ("--duration", "s", 10.0, "length of the flight"),
        ("--sample-rate", "Hz", 100.0, "samples per second"),
        ("--position-noise", "m", 0.0, "standard deviation of the measured position"),
        ("--velocity-noise", "m/s", 0.0, "standard deviation of the measured velocity"),
        ("--process-noise", "m/s^2", 0.0, "standard deviation of the noise on the acceleration"),
    ):
        log.add_argument(
            option,
            type=number(unit),
            default=default,
            metavar=unit.upper() if unit in ("s", "m") else unit,
            help=f"{text}; default: {default:g} {unit}",
        )
    log.add_argument(
        "--initial-position",
        type=number("m"),
        nargs=2,
        metavar=("X", "Y"),
        help="in m; default: drawn from one period of the flow",
    )
    log.add_argument("--seed", type=whole, default=0, help="of all that is random; default: 0")


def run(args: argparse.Namespace) -> int:
    """Simulate, write, and say what was written."""
    from numpy.random import SeedSequence

    from sparsefit.flight import simulate_flight
    from sparsefit.flight.faults import LogFaults
    from sparsefit.flight.record import MOST_SAMPLES
    from sparsefit.logs import write_flight
    from sparsefit.logs.files import WRITTEN

    check_output(args.output, force=args.force, endings=WRITTEN)
    flow, faults, (vehicle, thrust) = flow_of(args), faults_of(args), vehicle_of(args)
    samples = args.duration * args.sample_rate
    if MANY < samples <= MOST_SAMPLES:
        print(f"flying {samples:.3g} samples; Ctrl-C stops it, and writes nothing", file=sys.stderr)
    flight = simulate_flight(
        flow,
        vehicle,
        duration=args.duration,
        sample_rate=args.sample_rate,
        seed=args.seed,
        initial_position=args.initial_position,
        process_noise=args.process_noise,
        position_noise=args.position_noise,
        velocity_noise=args.velocity_noise,
        time_jitter=args.time_jitter,
        thrust=thrust,
        thrust_noise=args.thrust_noise,
    )
    if faults != LogFaults():
        flight = faults.spoil(flight, SeedSequence(args.seed, spawn_key=(FAULTY,)))
    write_flight(flight, args.output, overwrite=args.force)
    print(
        f"{one_line(args.output)}: {flight.samples} samples over {flight.duration:g} s, "
        f"{flight.extent:.3g} m across, in a flow of {args.mean_velocity:g} m/s and "
        f"{args.length_scale:g} m ({args.length_scale / args.mean_velocity:.3g} s)"
    )
    return 0
