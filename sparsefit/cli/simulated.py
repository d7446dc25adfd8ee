"""What `sparsefit simulate` flies through, and what it spoils: the options and their records."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from sparsefit.cli.parser import number
from sparsefit.errors import InputError, positive

if TYPE_CHECKING:
    from sparsefit.flight.faults import LogFaults
    from sparsefit.flight.flow import Flow
    from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries

SHAPING = ("heading", "stretch", "angle", "offset", "drift", "swell")
MEANT = {
    "turbulence_memory": "turbulence",
    "spectrum": "turbulence",
}  # an option, and the one that it says nothing without


def add_flow(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the flow."""
    group = parser.add_argument_group("flow")
    for option, unit, name, text in (
        ("--mean-velocity", "m/s", "U0", "of the cells, in m/s"),
        ("--length-scale", "m", "L", "side of a cell, in m"),
    ):
        group.add_argument(option, type=number(unit), required=True, metavar=name, help=text)
    for option, unit, names, text in (
        ("--wind", "m/s", ("X", "Y"), "a steady wind beside the flow, in m/s; default: none"),
        ("--heading", "rad", ("RAD",), "turns the cells counter-clockwise; default: 0"),
        ("--stretch", "", ("RATIO",), "side of a cell along its y axis over that along x, L"),
        ("--angle", "rad", ("RAD",), "between the walls of a cell; default: a right angle"),
        ("--offset", "m", ("X", "Y"), "where a corner of the cells is at the start, in m"),
        ("--drift", "m/s", ("X", "Y"), "velocity at which the cells move, in m/s; default: none"),
        (
            "--swell",
            "",
            ("SHARE", "S"),
            "share of U0 by which it swells and ebbs, and its period in s",
        ),
        ("--turbulence", "", ("RMS", "M"), "rms of each component in m/s, integral length in m"),
        ("--turbulence-memory", "s", ("S",), "integral time of turbulence; default: frozen"),
    ):
        nargs = len(names) if len(names) > 1 else None
        group.add_argument(
            option,
            type=number(unit),
            nargs=nargs,
            metavar=names if nargs else names[0],
            help=text,
        )
    group.add_argument(
        "--spectrum", choices=("dryden", "von-karman"), help="of turbulence; default: dryden"
    )


def add_faults(parser: argparse.ArgumentParser) -> None:
    """Declare the options of what goes wrong in the log."""
    group = parser.add_argument_group("faults of the log")
    group.add_argument(
        "--time-jitter",
        type=number(),
        default=0.0,
        metavar="SHARE",
        help="of a sample interval, below 0.5, by which samples are early or late; default: 0",
    )
    for option, names, text in (
        ("--wander", ("M", "S"), "rms of a position error that wanders, in m, and its time in s"),
        ("--outliers", ("SHARE", "M/S"), "share of velocities far off, and by how many m/s"),
        ("--jumps", ("COUNT", "M"), "jumps of the position, and their size in m"),
        ("--gaps", ("COUNT", "S"), "gaps, and the longest that they may be, in s"),
    ):
        group.add_argument(option, type=number(), nargs=2, metavar=names, help=text)


def flow_of(args: argparse.Namespace) -> Flow:
    """The flow that the options say.

    Raises:
        InputError: for an option without the one that it belongs to, or out of its range.
    """
    from sparsefit.flight.flow import Cells, CellularFlow, ShapedCells, SuperposedFlow
    from sparsefit.flight.turbulence import Turbulence

    for option, needed in MEANT.items():
        if getattr(args, option) is not None and getattr(args, needed) is None:
            raise InputError(f"--{option.replace('_', '-')} needs --{needed} too")
    cells: Cells = CellularFlow(args.mean_velocity, args.length_scale)
    if any(getattr(args, option) is not None for option in SHAPING):
        stretch = 1.0 if args.stretch is None else positive("--stretch", args.stretch)
        share, period = args.swell or (0.0, 1.0)
        angle = {} if args.angle is None else {"angle": args.angle}
        cells = ShapedCells(
            args.mean_velocity,
            (args.length_scale, stretch * args.length_scale),
            heading=args.heading or 0.0,
            offset=tuple(args.offset or (0.0, 0.0)),
            drift=tuple(args.drift or (0.0, 0.0)),
            swell=share,
            swell_period=period,
            **angle,
        )
    gusts: tuple[Turbulence, ...] = ()
    if args.turbulence:
        (rms, length), spectrum = args.turbulence, args.spectrum or "dryden"
        gusts = (Turbulence(rms, length, args.turbulence_memory, spectrum, args.seed),)
    wind = tuple(args.wind or (0.0, 0.0))
    return SuperposedFlow((cells, *gusts), wind) if gusts or any(wind) else cells


def faults_of(args: argparse.Namespace) -> LogFaults:
    """The faults that the options say.

    Raises:
        InputError: for one that is out of its range.
    """
    from sparsefit.flight.faults import LogFaults

    given: dict[str, Any] = {}
    for option, size in (
        ("wander", "wander_time"),
        ("outliers", "outlier_size"),
        ("jumps", "jump_size"),
        ("gaps", "gap_duration"),
    ):
        pair = getattr(args, option)
        if pair:
            given |= {option: pair[0], size: pair[1]}
    for count in ("jumps", "gaps"):
        if count in given and given[count] == round(given[count]):
            given[count] = round(given[count])
    return LogFaults(**given)


def vehicle_of(args: argparse.Namespace) -> tuple[PointMassVehicle, ThrustSeries | None]:
    """The vehicle that the options say, and the thrust that it measures beside its constant.

    Raises:
        InputError: for a value that is out of its range, or noise of a thrust that is not logged.
    """
    import math

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
