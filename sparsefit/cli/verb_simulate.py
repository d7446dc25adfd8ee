"""`sparsefit simulate`: simulate a flight and write its log.

Its options are the quantities that a study draws, by name: `length_scale` is `--length-scale`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from sparsefit.cli.options import FORCE, Option, OptionPlace, Verbs, option_of, verb
from sparsefit.cli.terminal import Reply, check_output
from sparsefit.errors import integer, one_line
from sparsefit.study.keys import QUANTITIES, FlightWords
from sparsefit.study.schema import described, sentences, shipped

DEFAULTS: dict[str, Any] = {
    "response_time": 0.5, "thrust_acceleration": [5.0, 3.0], "duration": 10.0, "sample_rate": 100.0
}  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    groups: dict[str, list[Option]] = {
        title: [] for title in ("flow", "vehicle", "flight", "faults of the log")
    }
    means = shipped("keys.toml")["flights"]
    for name, row in QUANTITIES.items():
        of_vehicle = any(word in name for word in ("response", "thrust", "drag"))
        title = "vehicle" if of_vehicle else "flight"
        if row.fault or name == "time_jitter":
            title = "faults of the log"
        elif row.of_flow or name.startswith("wind"):
            title = "flow"
        if name not in ("together", "measurement_noise"):  # which are of studies
            words = described(means[name], row.unit, row.range, DEFAULTS.get(name))
            metavar = "X Y" if len(row.streams) == 2 else row.unit or "NUMBER"
            groups[title].append(option_of(name, words, metavar, float))
    for name, words in sentences(FlightWords, "flights").items():
        groups["flow"].append(option_of(name, words, "NAME", str))
    options = (
        Option("--seed", "seed of the random numbers; default: 0", "N", int, default=0),
        Option("-o --output", "flight to write, .csv or .parquet", "FILE",
               required=True),
        FORCE,
    )  # fmt: skip
    verb(verbs, "simulate", run, options, groups)


def run(args: argparse.Namespace) -> Reply:
    """Simulate a flight through cells, in turbulence too, and write it to a file.

    example:
      sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 --response-time 0.5 \\
          --thrust-acceleration 5 3 --duration 10 --sample-rate 100 --seed 7 -o flight.csv
      sparsefit simulate --mean-velocity 15.43 --length-scale 4.2 --heading 0.3 --drift-ratio 0.1 \\
          --drift-direction 1 --turbulence-ratio 0.1 --turbulence-length 8 -o a.csv
      sparsefit simulate --mean-velocity 8 --length-scale 4 --drag 0.3 --outliers 0.01 -o drag.csv
      sparsefit simulate --mean-velocity 8 --timescale 1 --thrust-turn 6 --thrust-period 5 -o b.csv
    """
    from numpy.random import SeedSequence

    from sparsefit.logs import write_flight
    from sparsefit.logs.files import WRITTEN
    from sparsefit.study.draw import KEYS, read_flight_rules

    check_output(args.output, force=args.force, endings=WRITTEN)
    integer("--seed", args.seed, 0)
    given = {name: getattr(args, name, None) for name in KEYS}
    section = {name: value for name, value in given.items() if value is not None}
    default = {name: value for name, value in DEFAULTS.items() if name not in section}
    if "drag" in section:
        default.pop("response_time", None)
    draw = read_flight_rules(section | default, OptionPlace("")).draw(0, 1, args.seed)
    values = draw.values
    flight = replace(draw, turbulence_seed=args.seed).fly(SeedSequence(args.seed))
    write_flight(flight, args.output, overwrite=args.force)
    words = f"{flight.samples} samples over {flight.duration:g} s, {flight.extent:.3g} m across"
    record = {**values, "output": args.output, "seed": args.seed, "samples": flight.samples,
              "extent": flight.extent}  # fmt: skip
    return Reply(record, [f"{one_line(args.output)}: {words}"])
