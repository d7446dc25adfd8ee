"""The command line: verbs and their exit codes. What a verb needs is imported when it runs."""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
from collections.abc import Sequence

from sparsefit.cli import backends, estimate, export, select, simulate, study
from sparsefit.cli.parser import Parser
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_line
from sparsefit.whole_file import REMEDIES

INTERRUPTED = 130
BROKEN_PIPE = 141
BAD_INPUT = 2

EXAMPLE = """\
example:
  sparsefit simulate --mean-velocity 15.43 --length-scale 4.21 -o flight.csv
  sparsefit estimate flight.csv
  sparsefit VERB --help

exit code: 0 when what was asked was done, 1 when it was tried and failed, 2 for bad input
"""


def parser() -> Parser:
    """Every verb and option; builds in milliseconds, without numpy."""
    from sparsefit import __version__

    top = Parser(
        prog="sparsefit",
        description="Estimate the mean velocity, length scale and timescale of a flow from a "
        "flight, and choose the sparse regression back-end by study.",
        epilog=EXAMPLE,
    )
    top.add_argument("--version", action="version", version=f"sparsefit {__version__}")
    verbs = top.add_subparsers(title="verbs", metavar="VERB", dest="verb", required=True)
    for verb in (simulate, estimate, study, select, export, backends):
        verb.add(verbs)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return its exit code; bad input is one line on stderr, no traceback."""
    _print_what_can_be_printed()
    args = argparse.Namespace(stopped="stopped")
    try:
        args, extra = parser().parse_known_args(argv)
        if extra:
            args.parser.error(f"unrecognized arguments: {' '.join(extra)}")
        code: int = args.run(args)
        sys.stdout.flush()
    except KeyboardInterrupt:
        if argv is None:  # the process ends here: a second Ctrl-C has nothing to stop
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        print(f"\n{args.stopped}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        return _reader_left()
    except (Exception, MemoryError) as error:
        return _refused(error)
    return code


def _refused(error: BaseException) -> int:
    """Exit code of what a user can mend, said on one line; a bug of ours is raised again."""
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


def _print_what_can_be_printed() -> None:
    """A terminal that has no `τ` shows `?`, and nobody sees what is closed: no reasons to fail."""
    sys.stdout = sys.stdout or io.StringIO()
    sys.stderr = sys.stderr or sys.stdout
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _reader_left() -> int:
    """`sparsefit ... | head` is no error; the null device takes what Python still flushes."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return BROKEN_PIPE
