"""The documentation as a site: ``python -m sphinx docs build/docs``.

Its pages are those of this folder, the figures of ``bench/results``, and a page for every public
module, which is made from the list in ``api.md`` and the docstrings.
"""

import inspect
import re
import shutil
from importlib import import_module
from pathlib import Path

from sphinx.application import Sphinx

import tisfm

HERE = Path(__file__).parent
MADE = HERE / "made"  # pages that are not kept
RESULTS = HERE.parent / "bench" / "results"
ELSEWHERE = re.compile(r"\[([^\]\n]*)\]\((?:\.\./)*(?:\.ci|bench|tests|tisfm)/[^)\n]*\)")

project = "tisfm"
release = version = tisfm.__version__
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
]
nb_execution_mode = "auto"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
html_theme = "furo"
html_title = f"tisfm {release}"
html_show_copyright = html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["wide.css"]
root_doc = "index"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 6
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say more of them
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
default_role = "py:obj"


def public_names() -> dict[str, list[str]]:
    """Return the public names of every public module, as ``api.md`` lists them."""
    text = (HERE / "api.md").read_text(encoding="utf-8")
    modules = re.split(r"^## `([\w.]+)`.*$", text, flags=re.MULTILINE)[1:]
    return {
        module: re.findall(r"^\| `(\w+)` \|", body, re.MULTILINE)
        for module, body in zip(modules[::2], modules[1::2], strict=True)
    }


def _entry(module: str, name: str) -> str:
    """Return what autodoc is to show of a name."""
    value = getattr(import_module(module), name)
    kind = "class" if inspect.isclass(value) else "function" if callable(value) else "data"
    members = "\n   :members:" if kind == "class" and not issubclass(value, Exception) else ""
    value = "\n   :no-value:" if kind == "data" else ""
    return f".. auto{kind}:: {module}.{name}{members}{value}\n"


def make_pages(app: Sphinx) -> None:
    """Write the pages that are made: a module each, the figures, and the changes."""
    shutil.rmtree(MADE, ignore_errors=True)
    (MADE / "results").mkdir(parents=True)
    (MADE / "reference").mkdir()
    for page in RESULTS.glob("*.md"):
        shutil.copy(page, MADE / "results")
    for picture in RESULTS.glob("*.png"):
        shutil.copy(picture, MADE / "results")
    shutil.copy(HERE.parent / "CHANGELOG.md", MADE / "changelog.md")
    pages = sorted(
        page.stem for page in RESULTS.glob("*.md") if page.stem not in ("README", "tried")
    )
    listed = "\n".join(f"results/{name}" for name in pages)
    (MADE / "every_measurement.md").write_text(
        f"# Every measurement\n\n```{{toctree}}\n{listed}\n```\n", encoding="utf-8"
    )
    names = public_names()
    for module, members in names.items():
        lines = [f"{module}\n{'=' * len(module)}\n", f".. py:module:: {module}\n   :no-index:\n"]
        about = (import_module(module).__doc__ or "").partition("May import:")[0]
        lines += [inspect.cleandoc(about), ""]
        lines += [_entry(module, member) for member in members]
        (MADE / "reference" / f"{module}.rst").write_text("\n".join(lines), encoding="utf-8")


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


def setup(app: Sphinx) -> None:
    """Connect the above."""
    app.connect("builder-inited", make_pages)
    app.connect("source-read", here)
    app.connect("autodoc-process-docstring", plain_bars)
