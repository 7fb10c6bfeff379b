"""HTML is made in one way: by literals of Markup, which escape texts that are put into them."""

import ast
import re

import pytest

from tests.imports import sources

TAG = re.compile(r"</?[a-z!]", re.IGNORECASE)
# Markup of other values than literals: constants of ours, and drawings of Matplotlib.
TRUSTED = {"MARK", "STYLE", "SCRIPT", "box[0]", "rest"}


def html_of_other_means(text):
    """Return the lines of a module where HTML is put together, or plain text is called HTML."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value for part in node.values if isinstance(part, ast.Constant)]
            if any(TAG.search(part) for part in parts):
                found.append(node.lineno)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "Markup":
            literal = all(isinstance(one, ast.Constant) for one in node.args)
            if not literal and ast.unparse(node.args[0]) not in TRUSTED:
                found.append(node.lineno)
        elif isinstance(node, (ast.Import, ast.ImportFrom)) and "html" in (
            getattr(node, "module", None),
            *(one.name for one in node.names),
        ):
            module = getattr(node, "module", None) or "html"
            if not module.startswith("tisfm"):
                found.append(node.lineno)
    return found


def test_other_ways_are_found():
    assert html_of_other_means('x = f"<b>{name}</b>"') == [1]
    assert html_of_other_means("x = Markup(name)") == [1]
    assert html_of_other_means('x = Markup(f"{name}")') == [1]
    assert html_of_other_means("from html import escape") == [1]
    assert html_of_other_means("import html") == [1]
    assert html_of_other_means('x = Markup("<b>{}</b>").format(name)') == []
    assert html_of_other_means('x = f"a < {b}"') == []


@pytest.mark.parametrize("package", ["tisfm.report", "tisfm.view"])
def test_there_is_one_way(package):
    for name, path in sources().items():
        if name.startswith(package):
            assert html_of_other_means(path.read_text(encoding="utf-8")) == [], name


def test_a_control_refuses_plain_text():
    from types import SimpleNamespace

    from markupsafe import Markup

    from tisfm.view.html_texts import set_html

    control = SimpleNamespace(content="")
    with pytest.raises(TypeError, match="expected Markup"):
        set_html(control, "<b>")
    set_html(control, Markup("<b>{}</b>").format("<i>\ud800"))
    assert control.content == "<b>&lt;i&gt;?</b>" and type(control.content) is str
