"""Reading and writing of netCDF files, archives and BRDF files, with checksums."""
