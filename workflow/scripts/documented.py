"""Write numbers and figures of a run into the documents (map snakemake to `splits`)."""

import sys
from pathlib import Path

from splits.analysis.marks import documents, write_marked
from splits.analysis.quoted import quoted
from splits.figures.gallery import write_gallery
from splits.progress_log import write_line

RESULTS = Path(snakemake.log[0]).parents[1]
try:
    texts = quoted(RESULTS)
    changed = write_marked(texts, documents(), "docs/numbers.json")
    images, deleted = write_gallery(
        RESULTS / "figures", snakemake.params.figures, "docs/gallery/images"
    )
except (OSError, ValueError) as error:
    sys.exit(f"documented: {error}")
write_line(f"changed: {' '.join(map(str, [*changed, *images, *deleted])) or 'nothing'}", sys.stderr)
