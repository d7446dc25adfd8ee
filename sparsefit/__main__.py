"""`python -m sparsefit`, and the command `sparsefit`: both begin here."""

import os
import signal
import sys


def main() -> int:
    """Run the command line. Ctrl-C ends it in a line and with 130, also while it is imported."""
    try:
        from sparsefit.cli import main as run

        code = run()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done: there is nothing to stop
    except KeyboardInterrupt:
        print("\nstopped", file=sys.stderr)
        code = 130
    if code == 130:  # after Ctrl-C in an import Python would end as if nobody had caught it
        sys.stderr.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # the folder it is typed in, whose `signal.py` is none of ours
    sys.exit(main())
