"""Compare modelled and measured anisotropy factors (snakemake script)."""

from pathlib import Path

from splits import load
from splits.analysis.anisotropy import compare_with_measured, summarize_by_angle
from splits.analysis.measured import read_measured
from splits.experiments.papers.paper_tables import write_data_frame
from splits.plotting.anisotropy import draw_anisotropy
from splits.plotting.style import save_figure

dataset = load(snakemake.input.data[0])
table = compare_with_measured(dataset, read_measured(snakemake.input.directions))
misfits = summarize_by_angle(table)
write_data_frame(table, snakemake.output.table)
write_data_frame(misfits, snakemake.output.misfits)
# The principal plane is shown at a wavelength common to all samples.
shared = set.intersection(*(set(part.wavelength_nm) for _, part in table.groupby("saturation")))
middle = sorted(shared or set(table.wavelength_nm))[len(shared) // 3]
save_figure(
    draw_anisotropy(dataset, table, misfits, float(middle)),
    Path(snakemake.output.figure[0]).with_suffix(""),
)
