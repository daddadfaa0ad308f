"""Tallies of traced rays: exits, boundary crossings, fluxes, angular and radial distributions."""
