"""Interactive explorer: tables in one HTML file, interpolated as in Python."""
