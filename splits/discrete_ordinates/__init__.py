"""Radiative transfer in plane layers by discrete ordinates, without noise.

Modules, each importing only those above it:

- `streams`: directions of the streams, Legendre functions
- `integrals`: exponential modes, and their integrals along directions
- `layer_optics`: optics of homogeneous layers
- `modes`: solutions of the equation of transfer in them
- `slab`: their reflection and transmission
- `adding`: layers on top of each other, over a ground
- `pores`: refraction at the boundaries and interfaces of wet layers
- `geometry`: directions in air and within layers
- `direct_light`: light that is not scattered, or only once
- `layer_radiance`: reflection and transmission of a layer between directions
- `radiance`: reflected and transmitted radiance of layers
- `grain_table`: single scattering by the grains of natural snow
- `traced_grains`: single scattering by other grains, kept on disk
- `phase_series`: phase functions from a limited number of moments
- `granular_layers`: layers of grains and their optics
- `replicates`: the same without some of these paths, for errors
- `granular_stack`: spectra of layers, with errors
- `grain_tabulation`: makes the tables of the grains of natural snow
- `stack_profile`: fluxes, absorption and path lengths within layers
- `interval_profile`: the same between depths, by material, with errors
- `transmittance_error`: relative errors of small transmittances
- `stack_brdf`: reflected and transmitted radiance of layers, with errors
- `applicability`: media for which all this applies
- `levels`: light at the levels between dry layers
- `divided_differences`: of the impedances of a layer
- `derivatives`: derivatives with respect to the optics of dry layers
- `parameter_derivatives`: derivatives with respect to the parameters of a medium
- `derivative_errors`: their errors, and differences for wet snow
"""
