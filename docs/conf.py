"""Sphinx configuration: the pages of this folder, and a reference of every public name.

    make docs

The reference is written anew at every build (``docs/reference/``): one page for each package with
public names, and one for each name, from its docstring. Warnings are errors.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import textwrap
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
sys.path.insert(0, str(HERE))

import constants  # noqa: E402
import execute  # noqa: E402
import public_names  # noqa: E402

from oed_sysid.runtime.version import __version__  # noqa: E402

project = "oed_sysid"
author = "the authors of oed_sysid"
copyright = author
release = version = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 4
# Links into the source tree are checked by tests/test_docs.py; the site has no page for them.
suppress_warnings = ["myst.xref_missing", "myst.header", "ref.python"]
exclude_patterns = ["_build", "README.md", "gallery/*.txt"]
templates_path = ["_templates"]
autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
# MathJax and its fonts from an installed package: formulas are drawn without a network.
mathjax_path = "mathjax/tex-chtml.js"
html_static_path = [str(Path(find_spec("sphinx-mathjax-offline").origin).parent / "static")]
html_static_path.append("_static")
html_css_files = ["site.css"]
html_theme = "furo"
# Notebooks are executed below, where the package or a notebook has changed. `make test` shows them
# as they are: `make test-slow` executes them.
nb_execution_mode = "off"
nb_merge_streams = True
html_title = f"oed_sysid {release}"
html_show_sphinx = False


def write_reference() -> None:
    """One page for each package; a name stands on the page of the package that defines it."""
    folder = HERE / "reference"
    folder.mkdir(exist_ok=True)
    named = public_names.named()
    pages = []
    for package, title in (public_names.PACKAGES | public_names.MORE).items():
        if not named[package]:
            continue
        pages.append(package.replace(".", "_"))
        heading = f"{title}: ``{package}``"
        lines = [heading, "=" * len(heading), ""]
        if package != "oed_sysid":
            lines += [f".. automodule:: {package}", "   :no-members:", ""]
        lines += [".. autosummary::", "   :toctree: names", "   :nosignatures:", ""]
        prefix = "oed_sysid." if package == "oed_sysid" else ""
        lines += [f"   {prefix}{name}" for name in named[package]]
        _write(folder / f"{pages[-1]}.rst", [*lines, ""])
    pages.insert(1, write_effects(folder))
    pages.append("constants")
    _write(folder / "constants.rst", constants.page())
    words = (
        "Every public name: its arguments with shapes and units, what it raises, and an example."
    )
    words += " Most of them can be imported from ``oed_sysid`` itself."
    toctree = [".. toctree::", "   :maxdepth: 1", "", *(f"   {page}" for page in pages)]
    names = {f"{package}.{name}" for package, found in named.items() for name in found}
    # Pages of names that have moved since the last build.
    for page in [*folder.glob("*.rst"), *folder.glob("names/*.rst")]:
        if page.stem not in {*pages, *names, "index"}:
            page.unlink()
    _write(folder / "index.rst", ["Reference", "=========", "", words, "", *toctree, ""])


def write_effects(folder: Path) -> str:
    """A page with every effect of the library, from its table; returns the page's name."""
    library = import_module("oed_sysid.physics").LIBRARY
    columns = ("effect", "stage", "term", "unit", "shows in", "source")
    lines = ["Every effect of the library", "===========================", ""]
    lines += ["Braces hold arguments of the constructor, ``{E}`` is the amplitude.", ""]
    lines += [".. list-table::", "   :header-rows: 1", ""]
    rows = [columns]
    for name, entry in library.items():
        row = entry.row
        terms = row.derivative or "; ".join(row.terms.values()) or "as given"
        unit = "of the derivative" if row.derivative else row.unit or "of each amplitude"
        cells = (f"``{terms}``", f"``{unit}``", row.needs, row.source)
        rows.append((f":func:`~oed_sysid.physics.{name}`", row.kind.stage, *cells))
    for cells in rows:
        lines += [f"   {'*' if not i else ' '} - {cell}" for i, cell in enumerate(cells)]
    _write(folder / "library_of_effects.rst", [*lines, ""])
    return "library_of_effects"


def _write(path: Path, lines: list[str]) -> None:
    text = "\n".join(lines)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _open_branch_only(app: Any, page: str, template: str, context: dict, tree: Any) -> None:
    """Show names in the sidebar only below the part that is read.

    With the hundreds of names of the reference in every page, nine tenths of a build went into
    the sidebar.
    """
    if "toctree" in context:
        full = context["toctree"]
        context["toctree"] = lambda **options: full(**{**options, "collapse": True})


def _find_new_pages(app: Any) -> None:
    """Let pages of names be written for packages that an earlier build did not have."""
    app.project.discover(app.config.exclude_patterns, app.config.include_patterns)


def drawn() -> dict[str, tuple[str, str]]:
    """For each drawing function the picture of the gallery that shows it, and its lines."""
    found: dict[str, tuple[str, str]] = {}
    text = (HERE / "gallery.py").read_text(encoding="utf-8")
    for part in ast.parse(text).body:
        if isinstance(part, ast.FunctionDef):
            lines = "\n".join(text.splitlines()[part.body[0].lineno : part.end_lineno])
            for node in ast.walk(part):
                if isinstance(node, ast.Attribute) and node.attr.startswith(("plot_", "figure_")):
                    shown = textwrap.dedent(lines).replace("report.", "").replace("return ", "")
                    found.setdefault(node.attr, (part.name, shown))
    return found


DRAWN = drawn()


def _picture(name: str) -> list[str]:
    """Picture of a drawing function and the lines that draw it."""
    picture, code = DRAWN[name]
    code = textwrap.indent(code, "   ").splitlines()
    return [
        "", ".. rubric:: Example", "", f".. image:: /gallery/{picture}.png",
        f"   :alt: {picture.replace('_', ' ')}", "",
        "Drawn by these lines of the :doc:`gallery </gallery/index>`:", "",
        ".. code-block:: python", "", *code, "",
    ]  # fmt: skip


def _complete(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Add to a docstring the picture that a function draws."""
    last = name.rpartition(".")[2]
    if last in DRAWN and ".results." in f"{name}.":
        lines += _picture(last)


def setup(app: Any) -> None:
    """Change the sidebar before the theme makes it, and find pages before names are collected."""
    app.connect("autodoc-process-docstring", _complete)
    app.connect("builder-inited", _find_new_pages, priority=100)
    app.connect("html-page-context", _open_branch_only, priority=400)


# Before Sphinx looks for pages; in processes of their own, whose pictures leave no trace.
write_reference()
_scripts = ["gallery.py", "execute.py"]
if os.environ.get("OED_SYSID_SITE") == "text":
    execute.main(run=False)
    _scripts.remove("execute.py")
_makers = [subprocess.Popen([sys.executable, str(HERE / script)]) for script in _scripts]
if any([maker.wait() for maker in _makers]):
    raise RuntimeError("Pictures or notebooks of the site could not be made; see above.")
