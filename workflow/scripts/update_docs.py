"""Write numbers and figures of a run into the documents (snakemake script)."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path().resolve()))
sys.path.insert(0, str(Path("docs").resolve()))

from _numbers.gallery_images import write_gallery
from _numbers.marks import list_documents, update_documents
from _numbers.values import collect_quoted_numbers

from splits.core.progress import write_line

RESULTS = Path(snakemake.log[0]).parents[1]
try:
    texts = collect_quoted_numbers(RESULTS)
    changed = update_documents(texts, list_documents(), "docs/numbers.json")
    images, deleted = write_gallery(
        RESULTS / "figures", snakemake.params.figures, "docs/gallery/images"
    )
except (OSError, ValueError) as error:
    sys.exit(f"update_docs: {error}")
write_line(f"changed: {' '.join(map(str, [*changed, *images, *deleted])) or 'nothing'}", sys.stderr)
