"""Write the numbers of a run into the documents (map snakemake to `splits.analysis`)."""

import sys
from pathlib import Path

from splits.analysis.marks import documents, write_marked
from splits.analysis.quoted import quoted

try:
    texts = quoted(Path(snakemake.log[0]).parents[1])
    changed = write_marked(texts, documents(), "docs/numbers.json")
except (OSError, ValueError) as error:
    sys.exit(f"documented: {error}")
print("changed:", *changed or ["nothing"], file=sys.stderr)
