"""Files: netCDF with checksums, archives, caches, and snow pits of CAAML and Crocus."""
