"""Settings of the documentation: ``sphinx-build -W -n docs docs/_build``."""

from posecal import __version__

project = "posecal"
author = "The posecal authors"
copyright = "2026, The posecal authors"
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "numpydoc"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
templates_path = ["_templates"]
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
html_theme = "furo"
html_title = "posecal"
html_static_path = ["_static"]
html_css_files = ["posecal.css"]
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
suppress_warnings = ["myst.xref_missing"]
nitpick_ignore_regex = [  # docstrings may name what is not public; it has no page to link to
    ("py:mod", r"posecal\..+"),
    ("py:.*", r"posecal\.(calibration|data|engine|evaluation|geometry|metrics|plot|report|stats)\.[a-z_]+\..+"),
    ("py:.*", r"posecal\.errors\..+"),
]
