"""The command line: verbs and their exit codes. What a verb needs is imported when it runs."""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module

from sparsefit.cli.options import Option, Parser, print_help, verb
from sparsefit.cli.terminal import Reply, emit
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_line, optional
from sparsefit.whole_file import REMEDIES

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
        "flight, and\nchoose the sparse regression back-end by study.",
        epilog=EXAMPLE,
    )
    top.add_argument("--version", action="version", version=f"sparsefit {__version__}")
    top.set_defaults(run=print_help, parser=top, stopped="stopped", json=False)
    verbs = top.add_subparsers(title="verbs", metavar="VERB", dest="verb")
    for name in ("simulate", "estimate", "study", "select", "export", "backends"):
        import_module(f"sparsefit.cli.verb_{name}").add(verbs)
    shell = Option("shell", "bash, zsh or tcsh", "SHELL", choices=("bash", "zsh", "tcsh"))
    verb(verbs, "completion", completion, [shell])
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return its exit code; bad input is one line on stderr, no traceback."""
    sys.stdout = sys.stdout or io.StringIO()  # where they are closed
    sys.stderr = sys.stderr or sys.stdout
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that has no `τ` shows `?`
            stream.reconfigure(errors="replace")
    args = argparse.Namespace(stopped="stopped")
    try:
        args, extra = parser().parse_known_args(argv)
        if extra:
            args.parser.unrecognized(extra)
        reply: Reply = args.run(args)
        emit(reply, as_json=args.json)
    except KeyboardInterrupt:
        if argv is None:  # the process ends here: a second Ctrl-C has nothing to stop
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        print(f"\n{args.stopped}", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `sparsefit ... | head`: the null device takes what is still flushed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except SparsefitError as error:
        code, message = 2 if isinstance(error, InputError | MissingExtra) else 1, str(error)
    except ModuleNotFoundError as error:  # of sparsefit itself, too, where it was only unpacked
        code, message = 2, f"{error}: install sparsefit and what it needs (pip install .)"
    except UnicodeDecodeError:
        code, message = 2, "a file is not UTF-8 text; save it as UTF-8"
    except MemoryError:
        code, message = 2, "not enough memory; use fewer length scales or samples"
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        remedy = REMEDIES.get(error.errno or 0, "check the path")
        code, message = 2, f"{place}{error.strerror or error}; {remedy}"
    else:
        return reply.code
    print(f"sparsefit: error: {one_line(message)}", file=sys.stderr)
    return code


def completion(args: argparse.Namespace) -> Reply:
    """Print a script that completes verbs and options in a shell.

    example:
      eval "$(sparsefit completion bash)"   # in ~/.bashrc
    """
    shtab = optional("shtab", "completion needs shtab", "completion")
    script = shtab.complete(parser(), args.shell)
    return Reply({"shell": args.shell, "script": script}, [script])
