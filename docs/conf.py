"""How Sphinx builds these pages: `make docs`."""

from __future__ import annotations

import re
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import gpf
from gpf.core.runtime import choose_variant

choose_variant("auto")  # the integrators are defined for a variant

project, release = "Gaussian Photon Fields", gpf.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
templates_path = ["templates"]
default_role = "code"
highlight_language = "text"

html_theme = "furo"
html_title = project
html_show_copyright = False
html_static_path, html_css_files = ["static"], ["style.css"]
html_math_renderer = "mathml"

nb_execution_mode = "off"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_default_options = {"exclude-members": "model_config"}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
maximum_signature_line_length = 90
napoleon_custom_sections = [("Attributes", "params_style")]
ROOT = Path(gpf.__file__).parents[1]
inits = [file for top in ("gpf", "baselines") for file in ROOT.glob(f"{top}/**/__init__.py")]
packages = {".".join(file.relative_to(ROOT).parts[:-1]) for file in inits}
autosummary_context = {"packages": packages}


def lay_out(app, what, name, obj, options, lines):
    """From the layout of this project's docstrings to that of numpydoc and reStructuredText."""
    text = "\n".join(lines)
    table = ".. list-table::\n :widths: 20 10 70\n"
    text = text.replace(".. pluginparameters::\n", table)
    text = re.sub(r"\|(int|float|bool|string)\|", r"\1", text)
    head, rule, fields = re.split(r"^(-{5,})$|\Z", text, maxsplit=1, flags=re.M)
    # Indented lines are equations.
    head = re.sub(r"^((?!\.\. )\S.*)(?<!::)\n\n(?= {4}\S)", r"\1\n\n::\n\n", head, flags=re.M)
    # A description begins behind the name of its parameter.
    fields = re.sub(r"^([\w*, ]+): ", r"\1\n    ", fields, flags=re.M)
    # Behind a comment, napoleon does not take the words before a colon for the type of a value.
    comment = "..\n\n" if what in ("attribute", "data", "property") else ""
    lines[:] = f"{comment}{head}{rule or ''}{fields}".split("\n")


def link_to_pages(app, page, source):
    """Lead links to the README and to modules, which readers of the repository follow, to pages."""
    text = source[0].replace("](../README.md", "](index.md")
    module = re.compile(r"\[([^]]+)\]\(\.\./(gpf/[\w/]+)\.py\)")
    source[0] = module.sub(lambda m: f"{{py:mod}}`{m[1]} <{m[2].replace('/', '.')}>`", text)


def write_math(self, node):
    """Write an equation as MathML, which browsers show without a script from the network."""
    block = isinstance(node, nodes.math_block)
    self.body.append(tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


def setup(app):
    """Register the functions above; Sphinx calls this."""
    app.add_html_math_renderer("mathml", (write_math, None), (write_math, None))
    app.connect("autodoc-process-docstring", lay_out, priority=400)  # before napoleon
    app.connect("source-read", link_to_pages)
