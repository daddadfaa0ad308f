"""Reading and writing: netCDF, archives, BRDF files, checksums."""
