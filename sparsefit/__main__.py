"""`python -m sparsefit`: the same as the command `sparsefit`."""

import sys

if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # the folder it is typed in, whose `signal.py` is none of ours

    from sparsefit.cli import main

    sys.exit(main())
