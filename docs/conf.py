"""How the documentation site is built: `make docs`. What it adds to Sphinx is in `site_parts.py`."""

import sys
from importlib import metadata
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "sunspin"
author = "The sunspin developers"
version = release = metadata.version("sunspin")
project_copyright = author

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "site_parts"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
myst_dmath_double_inline = False
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "images", "records", "variables.md"]

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "none"  # the docstrings give shapes and units, which the types do not
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False

html_theme = "furo"
html_title = f"sunspin {release}"
html_math_renderer = "mathml"  # drawn by the browser itself: no script, no network
html_show_sphinx = False
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]
math_eqref_format = "({number})"
math_number_all = False
