"""Radiative transfer in plane layers by discrete ordinates, without noise.

Modules, each importing only those above it:

- `homogeneous_layer`: streams, modes, and their reflection and transmission
- `adding`: layers on top of each other, over a ground, the light at the levels between them, and
  refraction at the boundaries and interfaces of wet layers
- `radiance`: reflected and transmitted radiance of layers
- `grains`: single scattering by the grains of natural snow, and by other grains, kept on disk
- `granular_layers`: layers of grains and their optics, also without some of these paths, for errors
- `granular_stack`: spectra of layers, with errors, also of small transmittances
- `grain_tabulation`: makes the tables of the grains of natural snow
- `profiles`: fluxes, absorption by material and path lengths within layers, with errors
- `stack_brdf`: reflected and transmitted radiance of layers, with errors
- `applicability`: media for which all this applies
- `derivatives`: derivatives with respect to the parameters of a medium, with errors
- `snow_packs`: spectra of many snowpacks at once
"""
