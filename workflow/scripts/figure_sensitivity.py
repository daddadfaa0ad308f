"""Draw the mean sensitivity index (map snakemake to `splits.figures`)."""

from pathlib import Path

from splits import load
from splits.figures import save_figure, sensitivity_bars

figure = sensitivity_bars(load(snakemake.input[0]))
save_figure(figure, Path(snakemake.output[0]).with_suffix(""))
