"""From rays that left, or passed a face, to sums over wavelengths, places and directions."""
