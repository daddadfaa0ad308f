"""Virtual instruments: from a medium and its illumination to a labelled dataset with errors.

An instrument is a file ``NAME.py`` in this folder with the function ``NAME``, decorated by
`splits.core.keywords.declare_function`.  Nothing else lists it: it is ``splits.NAME`` in Python,
and ``instrument: {kind: NAME}`` in experiment files.
"""
