"""Analysis of datasets: colour, principal planes, tables of measured numbers, theories."""
