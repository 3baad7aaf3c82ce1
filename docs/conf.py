"""How Sphinx makes a site of these pages: `make docs` writes it to site/, and fails on any warning."""

import re
from importlib.metadata import version as version_of

import typer
from sphinx.application import Sphinx
from typer.cli import get_docs_for_click

from sumo_hmdp.cli import app

project = "sumo_hmdp"
version = release = version_of("sumo-hmdp")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["figures"]

# Links to headings are checked like links to files.
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"sumo_hmdp {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
highlight_language = "text"

# Docstrings are Google's; single backticks are code, as in Markdown.
default_role = "code"
napoleon_numpy_docstring = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
add_module_names = False

# Pages outside this folder have a page here that includes them, so links that are right in the repository stay right.
OUTSIDE = {
    "../networks/README.md": "networks.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changelog.md",
}


def prepare(_app: Sphinx, page: str, source: list[str]) -> None:
    """Turn links out of this folder to the pages that stand for them; add the reference of all commands."""
    up = "../" * page.count("/")
    for outside, inside in OUTSIDE.items():
        source[0] = source[0].replace(f"]({up}{outside}", f"]({up}{inside}")
    # An equation's number stands far right in the source, where it would be out of sight.
    source[0] = re.sub(r"(?m)^(    \S.*?) {4,}(\(\d+\))$", r"\1    \2", source[0])
    if page == "command-line":
        command = typer.main.get_command(app)
        context = typer.Context(command, info_name="sumo-hmdp")
        source[0] += "\n" + get_docs_for_click(obj=command, ctx=context, name="sumo-hmdp", indent=1)


def setup(sphinx: Sphinx) -> None:
    """Have pages prepared as they are read."""
    sphinx.connect("source-read", prepare)
