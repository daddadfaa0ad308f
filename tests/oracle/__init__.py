"""The scalar kernel of grains as it was before the transport core was rebuilt, frozen.

It shares no code with `splits.kernels`, so that what both agree on does not rest on one source.
Nothing here is to be changed when the package changes.
"""
