"""The command line: verbs and their exit codes. What a verb needs is imported when it runs."""

from __future__ import annotations

import argparse
import io
import json
import os
import signal
import sys
from collections.abc import Sequence

from sparsefit.cli import (
    verb_backends,
    verb_estimate,
    verb_export,
    verb_select,
    verb_simulate,
    verb_study,
)
from sparsefit.cli.options import Option, Parser, Reply, print_help, verb
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_line
from sparsefit.whole_file import REMEDIES

BAD_INPUT = 2
SHELLS, EVAL = ("bash", "zsh", "tcsh"), '  eval "$(sparsefit completion bash)"   # in ~/.bashrc\n'
EXAMPLE = """\
example:
  sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 -o flight.csv
  sparsefit estimate flight.csv
  sparsefit VERB --help

exit code: 0 when what was asked was done, 1 when it was tried and failed, 2 for bad input
"""


def parser() -> Parser:
    """The parser of all verbs and options; built in milliseconds, without numpy."""
    from sparsefit import __version__

    top = Parser(
        prog="sparsefit",
        description="Estimate the mean velocity, length scale and timescale of a flow from a "
        "flight, and choose the sparse regression back-end by study.",
        epilog=EXAMPLE,
    )
    top.add_argument("--version", action="version", version=f"sparsefit {__version__}")
    top.set_defaults(run=print_help, parser=top, stopped="stopped", json=False)
    verbs = top.add_subparsers(title="verbs", metavar="VERB", dest="verb")
    for module in (
        verb_simulate, verb_estimate, verb_study, verb_select, verb_export, verb_backends
    ):  # fmt: skip
        module.add(verbs)
    shells = Option("shell", "bash, zsh or tcsh", "SHELL", extra={"choices": SHELLS})
    verb(verbs, "completion", completion, EVAL, [shells])
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return its exit code; bad input is one line on stderr, no traceback."""
    _replace_unprintable()
    args = argparse.Namespace(stopped="stopped")
    try:
        args, extra = parser().parse_known_args(argv)
        if extra:
            args.parser.unrecognized(extra)
        answer: Reply = args.run(args)
        if args.json:
            print(json.dumps(answer.record, indent=2, allow_nan=False, ensure_ascii=False))
        else:
            print("\n".join(answer.lines))
        sys.stdout.flush()
    except KeyboardInterrupt:
        if argv is None:  # the process ends here: a second Ctrl-C has nothing to stop
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        print(f"\n{args.stopped}", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `sparsefit ... | head`: the null device takes what is still flushed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (Exception, MemoryError) as error:
        return _refused(error)
    return answer.code


def completion(args: argparse.Namespace) -> Reply:
    """Print a script that completes verbs and options in a shell."""
    try:
        import shtab
    except ImportError:
        raise MissingExtra("completion needs shtab: pip install 'sparsefit[completion]'") from None
    script = shtab.complete(parser(), args.shell)
    return Reply({"shell": args.shell, "script": script}, [script])


def _refused(error: BaseException) -> int:
    """The exit code of an error that a user can mend, told on one line; others are raised again."""
    if isinstance(error, SparsefitError):
        message, code = str(error), BAD_INPUT if isinstance(error, InputError | MissingExtra) else 1
    elif isinstance(error, UnicodeDecodeError):
        message, code = "a file is not UTF-8 text; save it as UTF-8", BAD_INPUT
    elif isinstance(error, MemoryError):
        message, code = "not enough memory; use fewer length scales or samples", BAD_INPUT
    elif isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        remedy = REMEDIES.get(error.errno or 0, "check the path")
        message, code = f"{place}{error.strerror or error}; {remedy}", BAD_INPUT
    else:
        raise error
    print(f"sparsefit: error: {one_line(message)}", file=sys.stderr)
    return code


def _replace_unprintable() -> None:
    """Let a terminal that has no `τ` show `?`, and closed streams take what is printed."""
    sys.stdout = sys.stdout or io.StringIO()
    sys.stderr = sys.stderr or sys.stdout
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
