"""`sparsefit select`: from a finished study to one estimator, or to why there is none."""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import FORCE, RESULTS, Option, OptionPlace, Verbs, option_of, verb
from sparsefit.cli.terminal import Progress, Reply, check_output, filled
from sparsefit.cli.verb_study import STUDY, read_study
from sparsefit.study.keys import SelectionRule
from sparsefit.study.schema import names_of, sentences
from sparsefit.whole_file import write_whole

if TYPE_CHECKING:
    from sparsefit.study.study import Study

READERS: dict[type, tuple[Any, str]] = {bool: (None, ""), int: (int, "N"), str: (str, "WORDS")}
RUN = (
    Option("--processes", "of --check; default: one per processor", "N", int),
    Option("--measure-again", "measure all latencies again", read=None),
    Option("-o --output", "estimator to write; default: estimator.json", "FILE",
           default="estimator.json"),
    FORCE,
)  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    words, rule = sentences(SelectionRule, "select"), list[Option]()
    for item in fields(SelectionRule):
        number = (float, item.metadata.get("unit") or "NUMBER")
        read, metavar = READERS.get(type(item.default), number)
        rule.append(option_of(item.name, words[item.name], metavar, read))
    groups = {"rule (in place of what [select] of the study file says)": rule}
    verb(verbs, "select", run, (STUDY, RESULTS, *RUN), groups)


def run(args: argparse.Namespace) -> Reply:
    """Choose one estimator from a finished study; write it and the evidence.

    example:
      sparsefit select studies/NAME.toml
      sparsefit select studies/NAME.toml --over worst --max-failure 0.02 --max-silent-misses 0
      sparsefit select studies/NAME.toml --criterion "95th percentile length-scale-error"
      sparsefit select studies/NAME.toml --on-board && sparsefit export estimator.json --c flow
    """
    from sparsefit.study import evidence
    from sparsefit.study.selection import headline, lines, select

    study = read_study(args)
    args.stopped = "stopped; run the same command again to continue"
    given = {name: getattr(args, name) for name in names_of(SelectionRule)}
    options = {name: value for name, value in given.items() if value is not None}
    rule = study.definition.select.changed(OptionPlace(""), **options)
    of_flights = study.kind == "flights"
    if of_flights:
        check_output(args.output, force=args.force)
    flown, refused, latencies = study, {}, {}
    if rule.on_board:  # the candidates that can fly; cases that are there stay
        flown, refused = _ran(study.flown(), args), study.refusals
    if rule.latency_flights and of_flights:
        untimed = rule.changed(max_latency_p99=None, max_memory=None)
        trials = [scored.candidate for scored in select(flown, untimed, latencies={}).passing]
        flights, again = rule.latency_flights, args.measure_again
        with Progress("candidates timed") as progress:
            latencies = flown.latency(trials, flights, again=again, progress=progress)
    selection = select(flown, rule, latencies=latencies, refusals=refused)
    chosen, checked = selection.chosen, None
    if chosen is not None and rule.check and of_flights:
        fresh = _ran(flown.variant(selection.contenders, rule.check), args)
        options = {"latencies": latencies, "candidate": chosen.candidate}
        checked = select(fresh, rule, **options)
    path = evidence.write_selection(study, selection, check=checked)[-1]
    record = evidence.record(selection, checked) | {"evidence": str(path)}
    usage = f"use it: sparsefit estimate FLIGHT --estimator {args.output}"
    if chosen is None:
        usage = f"nothing was chosen, and {args.output} is not written"
    elif of_flights:
        estimator = json.loads(study.estimator(chosen.candidate).to_json())
        estimator["provenance"] = evidence.provenance(study, selection)
        text = json.dumps(estimator, indent=2, allow_nan=False) + "\n"
        write_whole(args.output, text.encode())
        record |= {"output": args.output}
        usage = f"use it: sparsefit export {args.output} --c FOLDER" if rule.on_board else usage
    else:
        usage = f"use it: {study.call(chosen.candidate)}"
    listed = (f"- {line}" for line in lines(selection, checked))
    closing = f"every candidate, regime and time: {path}"
    said = [headline(selection), *listed, closing, usage]
    return Reply(record, filled(said), int(chosen is None))


def _ran(study: Study, args: argparse.Namespace) -> Study:
    """A part of a study, run; cases that this version of the code has run are not run again."""
    with Progress() as progress:
        study.run(processes=args.processes, stale=True, progress=progress)
    return study
