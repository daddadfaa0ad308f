"""Write numbers and figures of a run into the documents (map snakemake to `splits`)."""

import sys
from pathlib import Path

from splits.analysis.marks import documents, write_marked
from splits.analysis.quoted import quoted
from splits.figures.gallery import write_gallery

RESULTS = Path(snakemake.log[0]).parents[1]
try:
    texts = quoted(RESULTS)
    changed = write_marked(texts, documents(), "docs/numbers.json")
    images, deleted = write_gallery(
        RESULTS / "figures", snakemake.params.figures, "docs/gallery/images"
    )
except (OSError, ValueError) as error:
    sys.exit(f"documented: {error}")
print("changed:", *[*changed, *images, *deleted] or ["nothing"], file=sys.stderr)
