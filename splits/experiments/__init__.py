"""Experiments described by configuration files: validation, simulation and output."""

import lazy_loader

from splits.core.optional import import_optional

import_optional("yaml", "experiments", "experiments need")

# Modules of public names are imported on first use, so that a simulation does not import figures.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
