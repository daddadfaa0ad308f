"""Command `python -m splits`, the same as `splits`."""

import sys

from splits.cli import main

if __name__ == "__main__":
    sys.exit(main())
