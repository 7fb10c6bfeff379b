"""What makes the site of the documentation; the site itself is built by ``.ci/run``."""

import runpy
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from tests.test_docs import DOCS

for needed in ("sphinx", "ziamath"):
    pytest.importorskip(needed, reason="the extra docs is not installed")


@pytest.fixture(scope="module")
def site():
    return SimpleNamespace(**runpy.run_path(str(DOCS / "conf.py")))


def test_a_page_that_asks_another_host_is_found(site):
    for asking in (
        '<script async src="https://cdn.example.org/mathjax.js"></script>',
        '<img alt="x" src="//example.org/x.png">',
        '<link href="http://fonts.example.org/css" rel="stylesheet">',
        "@import 'https://example.org/a.css';",
        "p { background: url(https://example.org/a.png) }",
    ):
        assert site.from_elsewhere(asking), asking
    for quiet in (
        '<a href="https://example.org">there</a>',
        '<script src="../_static/doctools.js?v=1"></script>',
        '<svg xmlns="http://www.w3.org/2000/svg"></svg>',
        "p { background: url('data:image/svg+xml,<svg>') }",
    ):
        assert not site.from_elsewhere(quiet), quiet


@pytest.mark.parametrize("alone", [False, True])
def test_a_formula_is_drawn(site, alone):
    from docutils import nodes

    kind = nodes.math_block if alone else nodes.math
    body = []
    with pytest.raises(nodes.SkipNode):
        site.formula(
            SimpleNamespace(body=body),
            kind(text=r"\begin{pmatrix} \tau & \tfrac1Z \end{pmatrix} < T"),
        )
    (picture,) = ElementTree.fromstring(f"<p>{''.join(body)}</p>").iter(
        "{http://www.w3.org/2000/svg}svg"
    )
    assert picture.get("aria-label") == r"\begin{pmatrix} \tau & \tfrac1Z \end{pmatrix} < T"
    assert ("vertical-align" in picture.get("style", "")) == (not alone)
    assert len(list(picture)) > 4  # outlines of glyphs


def test_constants_have_their_line_and_value(site):
    names = site.public_names()
    line = names["tisfm.show"]["UNKNOWN_COLOR"]
    entry = site._entry("tisfm.show", "UNKNOWN_COLOR", line)
    assert line in entry and "``200, 200, 200``" in entry
    choices = site._entry("tisfm.datasets", "Layout", names["tisfm.datasets"]["Layout"])
    assert "'middlebury', " in choices
    for module, members in names.items():
        for name, line in members.items():
            entry = site._entry(module, name, line)
            assert entry.startswith((".. autoclass:: ", ".. autofunction:: ", ".. py:data:: "))
