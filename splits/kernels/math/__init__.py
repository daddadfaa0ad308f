"""Random numbers, vectors and elementary functions, in either precision."""
