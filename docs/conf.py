"""The documents as a site: `make docs`. Nothing of it is loaded from elsewhere, so it reads without a network."""

import sys
from importlib.metadata import version as installed
from pathlib import Path

from pygments.lexers import JsonLexer, TextLexer
from sphinx.application import Sphinx

sys.path[:0] = [str(Path(__file__).parent / "_ext"), str(Path(__file__).parents[1])]

project = "sweepid"
author = "the authors of sweepid"
version = release = installed("sweepid")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "commands", "constants", "http_api"]
exclude_patterns = ["_build", "_ext"]
source_suffix = {".md": "markdown"}

myst_heading_anchors = 4  # as in links between documents: lower case, hyphens
myst_enable_extensions = ["attrs_inline"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "undoc-members": True, "exclude-members": "__weakref__"}
python_use_unqualified_type_names = True
# types of Python and of libraries: their documents are elsewhere, and no network is asked
nitpick_ignore_regex = [(r"py:.*", r"(?!service\.client|drivers\.ports).*")]

html_theme = "pydata_sphinx_theme"
html_title = "sweepid"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_sidebars = {"index": [], "changelog": []}
html_theme_options = {
    "navbar_align": "left",
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": [], "changelog": []},
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_toc_level": 1,
}
html_context = {"default_mode": "auto"}


def setup(app: Sphinx) -> None:
    """Diagrams stay text: what would draw them comes from elsewhere, or brings a browser."""
    app.add_lexer("mermaid", TextLexer)
    app.add_lexer("jsonc", JsonLexer)
