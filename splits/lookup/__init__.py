"""Look-up tables: spectra over a grid of parameters, from as few paths as serve them all."""

from splits.lookup.measuring import table
from splits.lookup.reading import Table, open_table

__all__ = ["Table", "open_table", "table"]
