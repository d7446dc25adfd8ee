"""`sparsefit export`: an estimator as C99 for the processor on board."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.cli.estimator_file import read_estimator
from sparsefit.cli.output import check_folder
from sparsefit.cli.parser import Verbs, number, verb, whole
from sparsefit.errors import InputError, one_line, positive, told_with

if TYPE_CHECKING:
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.export import Plan
    from sparsefit.flight import Flight

EXAMPLE = """\
  sparsefit export estimator.json --c flow
  sparsefit export estimator.json --c flow --float --backend best-scale --derivative savgol \\
      --window 11 --refine variable-projection --correction none --flight flight.csv
  cmake -S flow -B flow/build && cmake --build flow/build && ctest --test-dir flow/build
"""


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "export",
        run,
        summary="write an estimator as C99: no heap, bounded work, with a test that replays a "
        "flight",
        example=EXAMPLE,
    )
    parser.add_argument(
        "estimator", metavar="ESTIMATOR", help="estimator file, .json, as sparsefit select writes"
    )
    parser.add_argument("--c", required=True, metavar="DIR", dest="folder", help="folder to write")
    real = parser.add_mutually_exclusive_group()
    real.add_argument(
        "--double",
        action="store_const",
        const="double",
        dest="real",
        help="numbers of 8 bytes (default)",
    )
    real.add_argument(
        "--float", action="store_const", const="float", dest="real", help="numbers of 4 bytes"
    )
    parser.add_argument(
        "--flight", metavar="FILE", help="recorded flight of the test; default: a simulated one"
    )
    parser.add_argument(
        "--ram", type=whole, metavar="BYTES", help="most that the state may take; default: 1 MiB"
    )
    parser.add_argument(
        "--compiler", metavar="CC", help="that measures the flash; default: cc, where there is one"
    )
    parser.add_argument("--force", action="store_true", help="write into DIR though it has files")
    _add_changes(parser)


def _add_changes(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("changes of the estimator, where a part cannot run on board")
    group.add_argument(
        "--backend", metavar="NAME", help="best-scale, stlsq or lasso, with its default settings"
    )
    group.add_argument(
        "--derivative", metavar="NAME", help="savgol, midpoint, central or forward: local rules"
    )
    group.add_argument("--window", type=whole, metavar="N", help="samples of savgol; default: 5")
    group.add_argument("--order", type=whole, metavar="N", help="degree of savgol; default: 4")
    group.add_argument("--refine", metavar="NAME", help="variable-projection or none")
    group.add_argument("--correction", metavar="NAME", help="none")
    group.add_argument(
        "--extent",
        type=number("m"),
        metavar="M",
        help="of the flights, for a grid of spacing 'flight'",
    )


def run(args: argparse.Namespace) -> int:
    """Write the C, and say what it takes."""
    from sparsefit.export import Plan, answers, package, refuse_large
    from sparsefit.export.measure import footprint
    from sparsefit.export.package import asked_at
    from sparsefit.export.plan import MOST_RAM
    from sparsefit.export.sheet import lines, sheet
    from sparsefit.export.source import body, header
    from sparsefit.whole_file import write_whole

    folder = check_folder(args.folder, force=args.force)
    plan = Plan(_changed(read_estimator(args.estimator), args), args.real or "double")
    refuse_large(plan, MOST_RAM if args.ram is None else args.ram)
    flight = _flight(args, plan)
    source = Path(args.estimator).name
    draft = {
        "sf_flow.h": header(plan, sheet(plan, source, None)).encode(),
        "sf_flow.c": body(plan).encode(),
    }
    measured = footprint(draft, args.compiler)
    told = list(answers(plan, flight, asked_at(flight)))
    for path, content in package(plan, flight, told, sheet(plan, source, measured)).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / path, content)
    scales = f"{len(plan.scales)} scales, {plan.scales[0]:g} to {plan.scales[-1]:g} m"
    print(f"{one_line(args.folder)}: sf_flow.h, sf_flow.c, CMakeLists.txt, README.md, test/")
    print(f"       {plan.backend.name}, {scales}, {plan.real}")
    print("\n".join(lines(plan, measured)))
    if all(answer.doubt for answer in told):
        print(f"note   no answer of the test's flight is ok; the last doubt is {told[-1].doubt}")
    return 0


def _changed(estimator: Estimator, args: argparse.Namespace) -> Estimator:
    """The estimator with what the command line changes of it."""
    from dataclasses import replace

    from sparsefit import backends
    from sparsefit.derivative import Derivative

    backend = backends.get(args.backend) if args.backend else estimator.backend
    derivative, library, readout = estimator.derivative, estimator.library, estimator.readout
    assert isinstance(derivative, Derivative)
    method = args.derivative or (derivative.method if args.window is None else "savgol")
    if method != derivative.method or args.window is not None or args.order is not None:
        derivative = Derivative(method, args.window, args.order, derivative.repair)
    if args.extent is not None:
        if library.grid.spacing != "flight":
            raise InputError(
                f"--extent is for a grid of spacing 'flight', not {library.grid.spacing!r}; drop it"
            )
        extent = positive("--extent", args.extent, "m")
        library = replace(library, grid=library.grid.resolving(extent))
    if args.refine is not None:
        readout = replace(readout, refine=args.refine)
    if args.correction is not None:
        readout = replace(readout, correction=args.correction)
    return replace(
        estimator, derivative=derivative, library=library, backend=backend, readout=readout
    )


def _flight(args: argparse.Namespace, plan: Plan) -> Flight:
    from sparsefit.export.example import example_flight
    from sparsefit.export.package import refuse_unlike
    from sparsefit.logs import read_flight

    if args.flight is None:
        return example_flight(plan)
    flight = read_flight(args.flight)
    with told_with(args.flight):
        refuse_unlike(plan, flight)
    return flight
