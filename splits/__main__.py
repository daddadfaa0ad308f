"""Command `python -m splits`, the same as `splits`."""

import sys

from splits.cli import main

sys.exit(main())
