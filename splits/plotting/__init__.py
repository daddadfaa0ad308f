"""Matplotlib figures of datasets."""

import lazy_loader

# Modules of public names are imported on first use, so that a figure imports what it shows.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
