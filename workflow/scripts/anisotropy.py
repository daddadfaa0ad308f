"""Hold directions against measured ones (map snakemake to `splits.analysis.anisotropy`)."""

from pathlib import Path

from splits import load
from splits.analysis.anisotropy import beside_measured, by_angle
from splits.analysis.measured import read_measured
from splits.analysis.tables import write_table
from splits.figures.anisotropy import anisotropy
from splits.figures.style import save_figure

dataset = load(snakemake.input.data[0])
table = beside_measured(dataset, read_measured(snakemake.input.directions))
misfits = by_angle(table)
write_table(table, snakemake.output.table)
write_table(misfits, snakemake.output.misfits)
# One that every sample was measured at, for the principal plane.
shared = set.intersection(*(set(part.wavelength_nm) for _, part in table.groupby("saturation")))
middle = sorted(shared or set(table.wavelength_nm))[len(shared) // 3]
save_figure(
    anisotropy(dataset, table, misfits, float(middle)),
    Path(snakemake.output.figure[0]).with_suffix(""),
)
