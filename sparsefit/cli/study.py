"""`sparsefit study`: check, plan, run and read a study."""

from __future__ import annotations

import argparse
import dataclasses

import sparsefit.cli.study_compare as study_compare
import sparsefit.cli.study_read as study_read
import sparsefit.cli.study_run as study_run
import sparsefit.cli.study_solvers as study_solvers
from sparsefit.cli.output import print_json
from sparsefit.cli.parser import Parser, Run, Verbs, add_results, verb

EXAMPLE = """\
  sparsefit study check studies/NAME.toml
  sparsefit study run studies/NAME.toml --processes 4
  sparsefit study show studies/NAME.toml
"""
SUMMARIES: dict[str, tuple[str, bool]] = {  # action -> what it does, whether it reads results
    "check": ("check a study file, and say on one line what it plans", False),
    "plan": ("count what a study will do and write", False),
    "run": ("run a study, or go on with one that was stopped", True),
    "status": ("tell how far a study is, also while it runs", True),
    "errors": ("list the cases that are not ok, grouped by reason", True),
    "show": ("print the tables of a study, also unfinished; or run one case again", True),
    "report": ("write tables, figures and report again from the stored cases", True),
}
HAVE_JSON = ("check", "plan", "run", "status", "errors", "show")


def add(verbs: Verbs) -> None:
    """Declare the verb and its actions."""
    parser = verb(
        verbs,
        "study",
        _no_action,
        summary="check, plan, run and read a study",
        example=EXAMPLE,
    )
    actions = parser.add_subparsers(metavar="ACTION", title="actions", dest="action", required=True)
    runs: dict[str, Run] = {"check": check, "plan": plan, "run": study_run.run} | study_read.RUNS
    for name, (summary, reads) in SUMMARIES.items():
        example = f"  sparsefit study {name} studies/NAME.toml\n"
        _add_common(
            verb(actions, name, by_kind(name, runs[name]), summary=summary, example=example),
            name,
            reads=reads,
        )
    study_run.add_options(actions.choices["run"])
    study_read.add_options(actions.choices["show"])
    study_compare.add(actions)


def by_kind(name: str, run: Run) -> Run:
    """The action on a study of flights, or on one of solvers where the file says so."""

    def chosen(args: argparse.Namespace) -> int:
        from sparsefit.study.spec.solver_study import is_solver_study

        return study_solvers.action(name)(args) if is_solver_study(args.study) else run(args)

    return chosen


def _add_common(parser: Parser, name: str, *, reads: bool) -> None:
    parser.add_argument("study", metavar="STUDY", help="study file, .toml")
    if reads:
        add_results(parser)
    if name in HAVE_JSON:
        parser.add_argument("--json", action="store_true", help="print JSON")


def _no_action(args: argparse.Namespace) -> int:
    raise AssertionError("argparse asks for an action")


def check(args: argparse.Namespace) -> int:
    """Exit 0 if the study file is valid."""
    from sparsefit.study.report.pages import check_outputs
    from sparsefit.study.spec.study import Study

    study = Study.load(args.study)
    check_outputs(study)
    if args.json:
        print_json({"study": study.name, "cases": study.planned, "hash": study.hash})
    else:
        print(f"{args.study}: ok, study {study.name} plans {study.planned} cases")
    return 0


def plan(args: argparse.Namespace) -> int:
    """What will be simulated, fitted and written."""
    from sparsefit.study.spec.outputs import name_of
    from sparsefit.study.spec.plan import counts
    from sparsefit.study.spec.study import Study

    study = Study.load(args.study)
    counted = counts(study)
    if args.json:
        written = {
            "tables": list(study.tables),
            "figures": list(study.figures),
            "answers": list(study.answers),
        }
        print_json({"study": study.name, **dataclasses.asdict(counted), **written})
        return 0
    each = counted.cases // sum(counted.settings.values())
    rows = [
        ("study", study.name),
        ("question", study.question),
        ("flights", str(counted.flights)),
        ("protocols", ", ".join(one.name for one in study.protocols)),
        *((f"sweep {key}", f"{levels} levels") for key, levels in counted.levels.items()),
        *(
            (f"back-end {label}", f"{size} settings, {size * each} cases")
            for label, size in counted.settings.items()
        ),
        ("cases", str(counted.cases)),
        (
            "work",
            f"{counted.simulations} simulations, {counted.problems} regression problems, "
            f"{counted.fits} fits",
        ),
        ("tables", ", ".join(map(name_of, study.tables)) or "those that fit the cases"),
        ("figures", ", ".join(map(name_of, study.figures)) or "those that fit the cases"),
        ("answers", ", ".join(map(name_of, study.answers)) or "none"),
    ]
    width = max(len(label) for label, _ in rows)
    print("\n".join(f"{label:<{width}}  {value}" for label, value in rows))
    return 0
