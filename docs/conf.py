"""How Sphinx builds the site from the pages of this folder: make docs."""

import subprocess
import sys
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

from reference_pages import write_reference

project = "anisoscope"
author = "the anisoscope authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
root_doc = "index"
exclude_patterns = ["examples", "schema", "notebooks"]
default_role = "code"  # docstrings write code between single backticks
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the signature would repeat the internal module of every type
napoleon_use_ivar = True
napoleon_use_rtype = False
myst_heading_anchors = 4
html_theme = "furo"
html_title = "anisoscope"
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_search_scorer = str(Path(__file__).with_name("search_order.js"))


def setup(app: Sphinx) -> None:
    """Write the reference before Sphinx looks for pages."""
    app.add_lexer("csv", TextLexer)
    app.connect("builder-inited", lambda started: write_reference(Path(started.srcdir) / "reference"))
    app.connect("builder-inited", write_papers)


def write_papers(app: Sphinx) -> None:
    """Write the page of the papers into the site; a row that differs from its paper ends the build."""
    if app.builder.format != "html":
        return
    page = Path(app.outdir) / "papers.html"
    page.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "anisoscope", "-q", "research", "papers", "--html", str(page)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
