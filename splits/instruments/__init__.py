"""Virtual instruments: from a medium and its illumination to a labelled dataset with errors.

An instrument is a file ``NAME.py`` in this folder with the function ``NAME``, decorated by
`splits.core.keywords.instrument`.  Nothing else lists it: it is ``splits.NAME`` in Python, and
``instrument: {kind: NAME}`` in experiment files.
"""

from splits.core.discovery import list_instrument_names, load_instrument

# Each one registers its name, which experiments look up.
for _name in list_instrument_names():
    load_instrument(_name)
