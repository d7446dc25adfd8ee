"""`sparsefit select`: from a finished study to one estimator, or to why there is none."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.cli.output import check_output, print_json, table_record
from sparsefit.cli.parser import Parser, Verbs, add_results, number, verb, whole
from sparsefit.cli.study_read import unfinished

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit.study.evidence.fresh import Check
    from sparsefit.study.evidence.selection import Selection
    from sparsefit.study.run.latency import Latency
    from sparsefit.study.spec.selection import SelectionRule
    from sparsefit.study.spec.study import Study

EXAMPLE = """\
  sparsefit select studies/NAME.toml
  sparsefit select studies/NAME.toml --over worst --max-failure 0.02 --max-silent-misses 0
  sparsefit select studies/NAME.toml --criterion "95th percentile length-scale-error"
  sparsefit estimate flight.csv --estimator estimator.json
"""
RULE = (  # option, type, metavar, help; the key of [select] is the option's name
    ("--criterion", str, "WORDS", "a summary and a measure; default: mean timescale-error"),
    ("--over", str, "WHICH", "average of the regimes, the worst of them, or the name of one"),
    ("--margin", number(), "SHARE", "how much worse than the best a simpler one may be"),
    ("--simplest", str, "HOW", "what simple means: listed first in the study file, or fastest"),
    ("--max-failure", number(), "SHARE", "most flights without an estimate, in every regime"),
    ("--max-silent-misses", number(), "SHARE", "most flights called ok and off by over 5 %%"),
    ("--max-error", number("%"), "PERCENT", "most of the 95th percentile of the largest error"),
    ("--max-latency-p99", number("s"), "S", "most of the 99th percentile of the latency"),
    ("--max-memory", number("MB"), "MB", "most peak memory of the process"),
    ("--latency-flights", whole, "N", "flights that each candidate is timed on; 0: none"),
    ("--check", whole, "N", "flights of fresh seeds to check the choice on; 0: none"),
    ("--seed", whole, "N", "of the bootstrap"),
)


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "select",
        run,
        summary="choose one estimator from a finished study, and write it and the evidence",
        example=EXAMPLE,
    )
    parser.add_argument("study", metavar="STUDY", help="study file, .toml, with a [split]")
    add_results(parser)
    _add_rule(parser)
    parser.add_argument(
        "--processes", type=whole, metavar="N", help="of --check; default: one per processor"
    )
    parser.add_argument(
        "--measure-again", action="store_true", help="time the candidates anew, known or not"
    )
    parser.add_argument(
        "-o",
        "--output",
        default="estimator.json",
        metavar="FILE",
        help="estimator to write; default: estimator.json",
    )
    parser.add_argument("--force", action="store_true", help="overwrite FILE")
    parser.add_argument("--json", action="store_true", help="print JSON")


def _add_rule(parser: Parser) -> None:
    rule = parser.add_argument_group("rule", "in place of what [select] of the study file says")
    for option, read, metavar, words in RULE:
        rule.add_argument(option, type=read, metavar=metavar, help=words)
    rule.add_argument(
        "--regime",
        action="append",
        dest="regimes",
        metavar="FACTOR",
        help="a factor whose levels are the regimes, world or flights.KEY; repeat it for more",
    )


def run(args: argparse.Namespace) -> int:
    """Choose, write, and show the evidence; 1 where no candidate keeps the constraints."""
    check_output(args.output, force=args.force)
    from sparsefit.codec import Place
    from sparsefit.study.evidence.deploy import estimator_text
    from sparsefit.study.evidence.selection import select
    from sparsefit.study.report.evidence_page import write_evidence
    from sparsefit.study.run import runner
    from sparsefit.study.run.store import read_cases
    from sparsefit.study.spec.selection import changed
    from sparsefit.study.spec.study import Study
    from sparsefit.whole_file import write_whole

    study = Study.load(args.study)
    here = Place(args.study, "select")
    rule = changed(study.selection, _options(args), study.protocols, study.sweep, here)
    found = runner.status(study, args.results)  # refuses the results of another study
    if not found.finished:
        raise unfinished(args.study, found)
    folder, cases = found.folder, read_cases(found.folder)
    times = _times(study, cases, folder, rule, again=args.measure_again)
    selection = select(study, cases, rule=rule, latencies=times)
    check = _check(study, selection, folder, args)
    if selection.chosen is not None:
        write_whole(args.output, estimator_text(study, selection))
    page = write_evidence(study, folder, selection, check)[-1]
    told = _Told(selection, check, args.output, page)
    if args.json:
        print_json(_record(told))
    else:
        print("\n".join(_lines(told)))
    return 0 if selection.chosen is not None else 1


def _options(args: argparse.Namespace) -> dict[str, object]:
    names = [option.strip("-").replace("-", "_") for option, *_ in RULE]
    given = {name: getattr(args, name) for name in (*names, "regimes")}
    return {name: value for name, value in given.items() if value is not None}


def _times(
    study: Study, cases: pd.DataFrame, folder: Path, rule: SelectionRule, *, again: bool
) -> dict[int, Latency]:
    """Time and memory of what keeps the other constraints; what is known is not measured again."""
    from dataclasses import replace

    from sparsefit.study.evidence.deploy import cells_of, latency_key, stored_latencies
    from sparsefit.study.evidence.selection import select
    from sparsefit.study.run.latency import measure, read_latency, write_latency

    if not rule.latency_flights:
        return {}
    known = {} if again else stored_latencies(study, cases, folder)
    untimed = replace(rule, simplest="listed", max_latency_p99=None, max_memory=None)
    left = [
        one.candidate
        for one in select(study, cases, rule=untimed).passing
        if one.candidate.place not in known
    ]
    trials = {latency_key(study, one): cells_of(study, one) for one in left}
    measured = measure(study, trials, rule.latency_flights, progress=_say if trials else None)
    if measured:
        kept = {} if again else read_latency(study, folder)
        write_latency(study, folder, {**kept, **measured})
    return known | dict(zip((one.place for one in left), measured.values(), strict=True))


def _check(
    study: Study, selection: Selection, folder: Path, args: argparse.Namespace
) -> Check | None:
    """Run what keeps the constraints on flights of fresh seeds; what is there is not run again."""
    from sparsefit.cli.progress import Bar, Lines
    from sparsefit.study.evidence.fresh import check_of, fresh_study
    from sparsefit.study.run import runner
    from sparsefit.study.run.store import read_cases

    if selection.chosen is None or not selection.rule.check:
        return None
    args.stopped = "stopped; run the same command again to continue"
    fresh = fresh_study(study, selection, selection.rule.check)
    progress = Bar() if sys.stderr.isatty() else Lines()
    try:
        summary = runner.run(fresh, folder, processes=args.processes, progress=progress)
    finally:
        progress.close()
    return check_of(fresh, selection, read_cases(summary.folder))


def _say(done: int, planned: int) -> None:
    print(f"timing candidate {done + 1} of {planned}", file=sys.stderr)


@dataclass(frozen=True)
class _Told:
    """What is printed: the selection, what fresh flights say, and the files it is in."""

    selection: Selection
    check: Check | None
    output: str
    page: Path

    @property
    def sentences(self) -> list[str]:
        from sparsefit.study.evidence.verdicts import checked, sentences

        more = checked(self.selection, self.check) if self.check else []
        return [*sentences(self.selection), *more]


def _record(told: _Told) -> dict[str, object]:
    from dataclasses import asdict

    from sparsefit.codec import finite_or_none
    from sparsefit.study.evidence.selection_tables import regime_table, selection_table
    from sparsefit.study.evidence.verdicts import headline

    selection = told.selection
    record: dict[str, object] = {
        "study": selection.study,
        "rule": asdict(selection.rule),
        "criterion": selection.criterion.words,
        "summary": headline(selection),
        "said": told.sentences,
        "candidates": len(selection.ranked),
        "eligible": len(selection.passing),
        "tied": [one.candidate.title for one in selection.tied],
        "evidence": str(told.page),
        "table": table_record(selection_table(selection)),
        "regimes": table_record(regime_table(selection)),
    }
    if (chosen := selection.chosen) is not None:
        record |= {
            "protocol": chosen.candidate.of("protocol"),
            "backend": chosen.candidate.of("backend"),
            "settings": json.loads(chosen.candidate.of("settings")),
            "factors": dict(chosen.candidate.factors),
            "validate": chosen.validate,
            "evaluate": chosen.evaluate,
            "interval": chosen.between,
            "probability_best": chosen.best,
            "regret": None if selection.regret is None else selection.regret.effect,
            "latency": None if chosen.latency is None else asdict(chosen.latency),
            "check": None if told.check is None else asdict(told.check),
            "output": told.output,
        }
    cleaned: dict[str, object] = finite_or_none(record)
    return cleaned


def _lines(told: _Told) -> list[str]:
    """The choice, why, and where all else stands: tables of it are files beside the page."""
    from sparsefit.study.evidence.verdicts import headline

    lines = [headline(told.selection), *(f"- {one}" for one in told.sentences)]
    lines.append(f"every candidate, regime and time: {told.page}, or evidence.html beside it")
    if told.selection.chosen is None:
        return [*lines, f"nothing was chosen, and {told.output} is not written"]
    return [*lines, f"use it: sparsefit estimate FLIGHT --estimator {told.output}"]
