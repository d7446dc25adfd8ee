"""`sparsefit simulate`: fly a simulated vehicle and write what it logs."""

from __future__ import annotations

import argparse
import math
import sys
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import FORCE, Option, Verbs, declare, number, verb, whole
from sparsefit.cli.terminal import check_output
from sparsefit.errors import InputError, one_line, positive

if TYPE_CHECKING:
    from sparsefit.flight.faults import LogFaults
    from sparsefit.flight.flow import Flow
    from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries

EXAMPLE = """\
  sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 --response-time 0.5 \\
      --thrust 5 3 --duration 10 --sample-rate 100 --seed 7 -o flight.csv
  sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 --heading 0.3 --drift 1 0.5 \\
      --turbulence 1.5 8 --outliers 0.01 5 -o windy.csv
  sparsefit simulate --mean-velocity 8 --length-scale 4 --drag 0.3 -o drag.csv
  sparsefit simulate --mean-velocity 8 --length-scale 4 --thrust-turn 6 5 -o circling.csv
"""
MANY = 100_000  # samples: beyond them a flight takes long enough to be announced
FAULTY = 100  # the child of the seed that faults are drawn from, as in a study
REQUIRED = {"required": True}
NUMBER = number()


def _default(value: float) -> dict[str, Any]:
    return {"default": value}


OPTIONS = {
    "flow": (
        Option("--mean-velocity", "of the cells, in m/s", "U0", number("m/s"), REQUIRED),
        Option("--length-scale", "side of a cell, in m", "L", number("m"), REQUIRED),
        Option("--wind", "steady wind beside the flow, in m/s; default: none", "X Y",
               number("m/s")),
        Option("--heading", "turns the cells counter-clockwise; default: 0", "RAD", number("rad")),
        Option("--stretch", "side of a cell along its y axis over that along x, L", "RATIO",
               NUMBER),
        Option("--angle", "between the walls of a cell; default: a right angle", "RAD",
               number("rad")),
        Option("--offset", "corner of the cells at the start, in m", "X Y", number("m")),
        Option("--drift", "velocity at which the cells move, in m/s; default: none", "X Y",
               number("m/s")),
        Option("--swell", "share of U0 by which it swells and ebbs, and its period in s",
               "SHARE S", NUMBER),
        Option("--turbulence", "rms of each component in m/s, integral length in m", "RMS M",
               NUMBER),
        Option("--turbulence-memory", "integral time of turbulence; default: frozen", "S",
               number("s")),
        Option("--spectrum", "of turbulence: dryden (default) or von-karman",
               extra={"choices": ("dryden", "von-karman")}),
    ),
    "vehicle": (
        Option("--response-time", "of linear drag; default: 0.5 s, with --drag none", "S",
               number("s")),
        Option("--drag", "quadratic drag; default: 0", "1/M", number("1/m"), _default(0.0)),
        Option("--thrust", "thrust acceleration; default: 5 3 m/s^2", "AX AY", number("m/s^2"),
               {"default": (5.0, 3.0)}),
        Option("--thrust-turn", "thrust in m/s^2 that turns once in so many seconds, beside "
               "--thrust; it is logged", "A S", NUMBER),
        Option("--thrust-noise", "standard deviation of the logged thrust; default: 0", "A",
               number("m/s^2"), _default(0.0)),
    ),
    "flight": (
        Option("--duration", "length of the flight; default: 10 s", "S", number("s"),
               _default(10.0)),
        Option("--sample-rate", "samples per second; default: 100 Hz", "HZ", number("Hz"),
               _default(100.0)),
        Option("--position-noise", "standard deviation of the measured position; default: 0 m",
               "M", number("m"), _default(0.0)),
        Option("--velocity-noise", "standard deviation of the measured velocity; default: 0 m/s",
               "M/S", number("m/s"), _default(0.0)),
        Option("--process-noise", "standard deviation of the noise on the acceleration; default: "
               "0 m/s^2", "M/S^2", number("m/s^2"), _default(0.0)),
        Option("--initial-position", "in m; default: drawn from one period of the flow", "X Y",
               number("m")),
        Option("--seed", "of all that is random; default: 0", "N", whole, {"default": 0}),
    ),
    "faults of the log": (
        Option("--time-jitter", "share of a sample interval, below 0.5, by which samples are "
               "early or late; default: 0", "SHARE", NUMBER, _default(0.0)),
        Option("--wander", "rms of a position error that wanders, in m, and its time in s",
               "M S", NUMBER),
        Option("--outliers", "share of velocities far off, and by how many m/s", "SHARE M/S",
               NUMBER),
        Option("--jumps", "jumps of the position, and their size in m", "COUNT M", NUMBER),
        Option("--gaps", "gaps, and the longest that they may be, in s", "COUNT S", NUMBER),
        Option("--lost-samples", "share of the samples that the log lost, one by one; default: 0",
               "SHARE", NUMBER),
    ),
}  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    summary = "simulate a flight through cells, in turbulence too, and write it to a file"
    parser = verb(verbs, "simulate", run, summary=summary, example=EXAMPLE)
    for title, options in OPTIONS.items():
        declare(parser.add_argument_group(title), options)
    output = Option("-o --output", "flight to write, .csv or .parquet", "FILE", extra=REQUIRED)
    declare(parser, (output, FORCE))


def run(args: argparse.Namespace) -> int:
    """Simulate, write, and say what was written."""
    from numpy.random import SeedSequence

    from sparsefit.flight import simulate_flight
    from sparsefit.flight.faults import LogFaults
    from sparsefit.flight.record import MOST_SAMPLES
    from sparsefit.logs import write_flight
    from sparsefit.logs.files import WRITTEN

    check_output(args.output, force=args.force, endings=WRITTEN)
    flow, faults, (vehicle, thrust) = _flow(args), _faults(args), _vehicle(args)
    if MANY < (samples := args.duration * args.sample_rate) <= MOST_SAMPLES:
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


def _flow(args: argparse.Namespace) -> Flow:
    """The flow of the options. Raises InputError for an option without the one it belongs to."""
    from sparsefit.flight.flow import Cells, CellularFlow, ShapedCells, SuperposedFlow
    from sparsefit.flight.waves import Turbulence

    for option in ("turbulence_memory", "spectrum"):
        if getattr(args, option) is not None and args.turbulence is None:
            raise InputError(f"--{option.replace('_', '-')} needs --turbulence too")
    cells: Cells = CellularFlow(args.mean_velocity, args.length_scale)
    shaping = ("heading", "stretch", "angle", "offset", "drift", "swell")
    if any(getattr(args, option) is not None for option in shaping):
        stretch = 1.0 if args.stretch is None else positive("--stretch", args.stretch)
        share, period = args.swell or (0.0, 1.0)
        cells = ShapedCells(
            args.mean_velocity,
            (args.length_scale, stretch * args.length_scale),
            heading=args.heading or 0.0,
            offset=tuple(args.offset or (0.0, 0.0)),
            drift=tuple(args.drift or (0.0, 0.0)),
            swell=share,
            swell_period=period,
            angle=0.5 * math.pi if args.angle is None else args.angle,
        )
    gusts: tuple[Turbulence, ...] = ()
    if args.turbulence:
        (rms, length), spectrum = args.turbulence, args.spectrum or "dryden"
        gusts = (Turbulence(rms, length, args.turbulence_memory, spectrum, args.seed),)
    wind = tuple(args.wind or (0.0, 0.0))
    return SuperposedFlow((cells, *gusts), wind) if gusts or any(wind) else cells


def _faults(args: argparse.Namespace) -> LogFaults:
    """The faults of the options. Raises InputError for one that is out of its range."""
    from sparsefit.flight.faults import LogFaults

    given: dict[str, Any] = {}
    sizes = {"wander": "wander_time", "outliers": "outlier_size", "jumps": "jump_size"}
    for option, size in (sizes | {"gaps": "gap_duration"}).items():
        if (values := getattr(args, option)) is not None:
            given |= {option: values[0], size: values[1]}
    for count in ("jumps", "gaps"):
        if count in given and given[count] == round(given[count]):
            given[count] = round(given[count])
    if args.lost_samples is not None:
        given["lost_samples"] = args.lost_samples
    return LogFaults(**given)


def _vehicle(args: argparse.Namespace) -> tuple[PointMassVehicle, ThrustSeries | None]:
    """The vehicle of the options, and the thrust that it logs beside its constant.

    Raises InputError for a value out of its range, or noise of a thrust that is not logged.
    """
    from sparsefit.flight.vehicle import PointMassVehicle, turning

    default = math.inf if args.drag else 0.5
    response = default if args.response_time is None else args.response_time
    constant = tuple(args.thrust)
    if args.thrust_turn is None:
        if args.thrust_noise:
            raise InputError("--thrust-noise needs --thrust-turn too: a constant is not logged")
        return PointMassVehicle(response, constant, args.drag), None
    size, period = args.thrust_turn
    series = turning(
        args.duration, args.sample_rate, constant=constant, size=size, period=period, phase=0.0
    )
    return PointMassVehicle(response, drag=args.drag), series
