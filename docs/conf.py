"""How Sphinx builds the site of docs/ (make docs).

Nothing is fetched, neither by the build nor by a browser: no web fonts, no scripts from elsewhere,
formulas as MathML.
"""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

from jupyter_client.manager import KernelManager

from splits.core.provenance import PACKAGE_FOLDER, hash_files

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE)]

project = "splits"
author = "The authors of splits-optics"
version = release = version_of("splits-optics")
project_copyright = author

extensions = [
    "myst_nb", "sphinx.ext.autodoc", "numpydoc",
    "mathml", "marked_numbers", "gallery", "configuration", "command_help", "signatures",
]  # fmt: skip
exclude_patterns = ["_build", "_ext", "_numbers", "_templates"]
templates_path = ["_templates"]
# Single backticks in docstrings are links if their target exists.
default_role = "py:obj"

html_theme = "furo"
html_title = f"splits {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False
html_math_renderer = "mathml"
pygments_style = "friendly"
pygments_dark_style = "monokai"

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
myst_update_mathjax = False
myst_links_external_new_tab = False

# Examples run while the site is built, each page in its own folder, and again only if the page or
# the package has changed.
nb_execution_mode = "cache"
# Kernels print a warning if their connections are not encrypted.
KernelManager.transport_encryption.default_value = "auto"
SOURCES = sorted(
    p.relative_to(PACKAGE_FOLDER).as_posix() for p in PACKAGE_FOLDER.rglob("*.[pc]*[yv]")
)
nb_execution_cache_path = str(HERE / "_build" / "cache" / hash_files(PACKAGE_FOLDER, SOURCES))
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_kernel_rgx_aliases = {".*": "python3"}
nb_output_stderr = "error"
nb_merge_streams = True
nb_number_source_lines = False
nb_ipywidgets_js = {}

autodoc_typehints = "none"
autodoc_member_order = "bysource"
python_maximum_signature_line_length = 80
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
