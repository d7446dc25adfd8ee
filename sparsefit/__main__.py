"""`python -m sparsefit`: the same as the command `sparsefit`."""

import sys

from sparsefit.cli import main

if __name__ == "__main__":
    sys.exit(main())
