"""The documentation as a site: ``python -m sphinx docs build/docs``.

Its pages are those of this folder, the figures of ``bench/results``, and a page for every public
module, which is made from the list in ``api.md`` and the docstrings.
"""

import inspect
import re
import shutil
from importlib import import_module
from pathlib import Path
from typing import get_args
from xml.etree.ElementTree import tostring

import ziamath
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

import tisfm

HERE = Path(__file__).parent
RESULTS = HERE.parent / "bench" / "results"
ELSEWHERE = re.compile(r"\[([^\]\n]*)\]\((?:\.\./)*(?:\.ci|bench|tests|tisfm)/[^)\n]*\)")
LOG = logging.getLogger(__name__)

project = "tisfm"
release = version = tisfm.__version__
extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx_copybutton"]
ziamath.config.svg2 = False  # glyphs as outlines: pages with many formulas share no names
nb_execution_mode = "auto"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
html_theme = "furo"
html_title = f"tisfm {release}"
html_show_copyright = html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["wide.css"]
root_doc = "index"
html_math_renderer = "drawn"  # not MathJax, which a page fetches from elsewhere
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 6
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say more of them
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
default_role = "py:obj"


def public_names() -> dict[str, dict[str, str]]:
    """Return the public names of every public module, and a line on each, as ``api.md`` has it."""
    text = (HERE / "api.md").read_text(encoding="utf-8")
    modules = re.split(r"^## `([\w.]+)`.*$", text, flags=re.MULTILINE)[1:]
    return {
        module: dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", body, re.MULTILINE))
        for module, body in zip(modules[::2], modules[1::2], strict=True)
    }


def _entry(module: str, name: str, line: str) -> str:
    """Return what the page of a module is to show of a name, which has a line in ``api.md``."""
    value = getattr(import_module(module), name)
    if inspect.isclass(value):
        members = "" if issubclass(value, Exception) else "\n   :members:"
        # members of base classes of our own belong to the page as well
        if members and any(base.__module__.startswith("tisfm.") for base in value.__mro__[1:]):
            members += "\n   :inherited-members: object"
        return f".. autoclass:: {module}.{name}{members}\n"
    if inspect.isfunction(value):
        return f".. autofunction:: {module}.{name}\n"
    # A constant has no docstring but that of its type, which says nothing of it.
    shown = get_args(value) or (tuple(value) if isinstance(value, dict) else value)
    what = ", ".join(map(repr, shown)) if isinstance(shown, tuple) else repr(shown)
    return f".. py:data:: {name}\n   :module: {module}\n\n   {line}: ``{what}``\n"


def make_pages(app: Sphinx) -> None:
    """Write the pages that are made, which are not kept: modules, the figures, the changes."""
    made = Path(app.srcdir) / "made"
    shutil.rmtree(made, ignore_errors=True)
    (made / "results").mkdir(parents=True)
    (made / "reference").mkdir()
    for page in RESULTS.glob("*.md"):
        shutil.copy(page, made / "results")
    for picture in RESULTS.glob("*.png"):
        shutil.copy(picture, made / "results")
    shutil.copy(HERE.parent / "CHANGELOG.md", made / "changelog.md")
    pages = sorted(
        page.stem for page in RESULTS.glob("*.md") if page.stem not in ("README", "tried")
    )
    listed = "\n".join(f"results/{name}" for name in pages)
    (made / "every_measurement.md").write_text(
        f"# Every measurement\n\n```{{toctree}}\n{listed}\n```\n", encoding="utf-8"
    )
    names = public_names()
    for module, members in names.items():
        lines = [f"{module}\n{'=' * len(module)}\n", f".. py:module:: {module}\n   :no-index:\n"]
        about = (import_module(module).__doc__ or "").partition("May import:")[0]
        lines += [inspect.cleandoc(about), ""]
        lines += [_entry(module, member, line) for member, line in members.items()]
        (made / "reference" / f"{module}.rst").write_text("\n".join(lines), encoding="utf-8")


def here(app: Sphinx, docname: str, source: list[str]) -> None:
    """Let links between pages lead to where the pages lie in the site."""
    text = source[0]
    if docname.startswith("made/results/"):
        text = text.replace("](../../docs/", "](../../").replace("](../../../", "](../../")
    elif docname == "made/changelog":
        text = text.replace("](docs/", "](../").replace("](bench/results/", "](results/")
    else:
        up = "../" * docname.count("/")
        text = text.replace(f"]({up}../bench/results/", f"]({up}made/results/")
        text = text.replace(f"]({up}../CHANGELOG.md", f"]({up}made/changelog.md")
    # What lies elsewhere in the project has no page: its name stays.
    source[0] = ELSEWHERE.sub(r"\1", text)


def plain_bars(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Let bars in docstrings be bars: |Z| is no substitution."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def formula(to: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write a formula, in the line or on its own, as a drawing (SVG)."""
    latex, alone = node.astext(), isinstance(node, nodes.math_block)
    drawn = ziamath.Latex(
        latex.replace("{aligned}", "{align*}"), size=17, color="currentColor", inline=not alone
    )
    picture = drawn.svgxml()
    picture.set("role", "img")
    picture.set("aria-label", latex)
    if not alone:
        picture.set("style", f"vertical-align: {drawn.getyofst():.2f}px")
    text = tostring(picture, encoding="unicode")
    to.body.append(f'<div class="math">{text}</div>\n' if alone else text)
    raise nodes.SkipNode


def from_elsewhere(text: str) -> list[str]:
    """Return the addresses that a browser fetches from another host to show a page or a style."""
    tags = r"<(?:script|img|link|iframe|source|video|audio)\b[^>]*?\b(?:src|href)="
    styles = r"@import\s+|url\(\s*"
    return re.findall(rf"(?:{tags}|{styles})[\"']?((?:https?:)?//[\w.:-]+)", text)


def ask_nobody(app: Sphinx, problem: Exception | None) -> None:
    """Warn of pages that need a network: the site is also read without one."""
    for file in (file for kind in ("html", "css") for file in app.outdir.rglob(f"*.{kind}")):
        for address in from_elsewhere(file.read_text(encoding="utf-8")):
            LOG.warning("%s asks %s", file.name, address)


def setup(app: Sphinx) -> None:
    """Connect the above."""
    app.add_html_math_renderer("drawn", (formula, None), (formula, None))
    app.connect("builder-inited", make_pages)
    app.connect("source-read", here)
    app.connect("autodoc-process-docstring", plain_bars)
    app.connect("build-finished", ask_nobody)
