"""Radiative transfer in plane layers by discrete ordinates, without noise.

Modules, each importing only those above it:

- `streams`: directions of the streams, Legendre functions
- `slab`: reflection and transmission of homogeneous layers
- `adding`: layers on top of each other, over a ground
"""
