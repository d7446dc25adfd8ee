"""`sparsefit select`: from a finished study to one estimator, or to why there is none."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import (
    FORCE,
    JSON,
    RESULTS,
    Answer,
    Option,
    Verbs,
    declare,
    number,
    option_of,
    verb,
    whole,
)
from sparsefit.cli.terminal import Progress, check_output
from sparsefit.cli.verb_study import STUDY, stored
from sparsefit.study.keys import SelectionRule
from sparsefit.study.schema import names_of, sentences

if TYPE_CHECKING:
    from sparsefit.study.selection import Check, Selection
    from sparsefit.study.study import Study

EXAMPLE = """\
  sparsefit select studies/NAME.toml
  sparsefit select studies/NAME.toml --over worst --max-failure 0.02 --max-silent-misses 0
  sparsefit select studies/NAME.toml --criterion "95th percentile length-scale-error"
  sparsefit select studies/NAME.toml --on-board && sparsefit export estimator.json --c flow
"""
READERS: dict[type, tuple[Any, str]] = {
    bool: (None, ""), int: (whole, "N"), str: (str, "WORDS")
}  # fmt: skip
RUN = (
    Option("--processes", "of --check; default: one per processor", "N", whole),
    Option("--measure-again", "time the candidates anew, known or not", read=None),
    Option("-o --output", "estimator to write; default: estimator.json", "FILE",
           extra={"default": "estimator.json"}),
    FORCE,
    JSON,
)  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(verbs, "select", run, EXAMPLE)
    declare(parser, (STUDY, RESULTS))
    rule = parser.add_argument_group("rule", "in place of what [select] of the study file says")
    words = sentences(SelectionRule)
    for item in fields(SelectionRule):
        unit = item.metadata["unit"]
        read, metavar = number(unit), unit.upper() or "NUMBER"
        if isinstance(item.default, bool | int | str):
            read, metavar = READERS[type(item.default)]
        declare(rule, [option_of(item.name, words[item.name], metavar, read)])
    declare(parser, RUN)


def run(args: argparse.Namespace) -> Answer:
    """Choose one estimator from a finished study, and write it and the evidence."""
    check_output(args.output, force=args.force)
    from sparsefit.study import evidence
    from sparsefit.study.selection import select
    from sparsefit.whole_file import write_whole

    study, _ = stored(args, whole=True)
    given = {name: getattr(args, name) for name in names_of(SelectionRule)}
    options = {name: value for name, value in given.items() if value is not None}
    rule = study.definition.selection.changed(**options)
    flown, refused = study, {}
    if rule.on_board:
        flown, refused = _flown(study, args), study.refusals
    latencies = {}
    if rule.latency_flights and study.kind == "flights":
        untimed = rule.changed(max_latency_p99=None, max_memory=None)
        latencies = flown.latency(
            [scored.candidate for scored in select(flown, untimed, latencies={}).passing],
            rule.latency_flights,
            again=args.measure_again,
            progress=_announce,
        )
    selection = select(flown, rule, latencies=latencies, refusals=refused)
    checked = _check(flown, selection, args)
    usage = f"use it: sparsefit estimate FLIGHT --estimator {args.output}"
    if selection.chosen is None:
        usage = f"nothing was chosen, and {args.output} is not written"
    elif study.kind == "problems":
        usage = f"use it: {_call(study, selection.chosen.candidate)}"
    else:
        estimator = json.loads(study.estimator(selection.chosen.candidate).to_json())
        estimator["provenance"] = evidence.provenance(study, selection)
        text = json.dumps(estimator, indent=2, allow_nan=False) + "\n"
        write_whole(args.output, text.encode())
    path = evidence.write_selection(study, selection, check=checked)[-1]
    record = evidence.record(selection, checked) | {"evidence": str(path)}
    if selection.chosen is not None and study.kind == "flights":
        record |= {"output": args.output}
    lines = (f"- {line}" for line in evidence.lines(selection, checked))
    said = [evidence.headline(selection), *lines]
    closing = f"every candidate, regime and time: {path}, or evidence.html beside it"
    return Answer(record, [*said, closing, usage], int(selection.chosen is None))


def _call(study: Study, candidate: str) -> str:
    """The call from Python of a candidate of a study of problems."""
    cell, cells = study.cells_of(candidate)[0], study.experiment.cells()
    settings = json.loads(cells["settings"][cell])
    words = "".join(f", {name}={value!r}" for name, value in settings.items())
    return f"sf.path(problem, {cells['backend'][cell]!r}{words})"


def _flown(study: Study, args: argparse.Namespace) -> Study:
    """The candidates that can fly, on the flights of the study; cases that are there stay."""
    args.stopped = "stopped; run the same command again to continue"
    flown = study.flown()
    with Progress() as progress:
        flown.run(processes=args.processes, progress=progress)
    return flown


def _check(study: Study, selection: Selection, args: argparse.Namespace) -> Check | None:
    """The contenders on flights of fresh seeds; cases that are there are not run again."""
    from sparsefit.study.selection import check

    if selection.chosen is None or not selection.rule.check or study.kind != "flights":
        return None
    args.stopped = "stopped; run the same command again to continue"
    fresh = study.variant(selection.contenders, selection.rule.check)
    with Progress() as progress:
        fresh.run(processes=args.processes, progress=progress)
    return check(selection, fresh.cases)


def _announce(done: int, planned: int, left: float | None) -> None:
    print(f"timing candidate {done + 1} of {planned}", file=sys.stderr)
