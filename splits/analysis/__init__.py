"""Analysis of datasets: sensitivity, colour, anisotropy and comparison with measurements."""
