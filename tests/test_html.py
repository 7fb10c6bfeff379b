"""HTML is made in one way: by templates of Jinja, which escape all texts put into them."""

import ast
import re

import pytest

from tests.imports import sources
from tisfm import templates as html

TAG = re.compile(r"</?[a-z!]", re.IGNORECASE)
# Values that are not escaped: a constant, drawings of Matplotlib, and what a template returned.
TRUSTED = {"MARK", "f'<svg {box[0]} role=\"img\">{rest}'"}
FILES = {".html", ".css", ".js"}


def html_of_other_means(text):
    """Return the lines of a module that hold HTML, or call plain text HTML."""
    lines = []
    tree = ast.parse(text)
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
        and isinstance(node.body[0], ast.Expr)
    }
    trusted = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Markup" and node.args:
            if ast.unparse(node.args[0]) in TRUSTED:
                trusted |= {id(part) for part in ast.walk(node)}
            else:
                lines.append(node.lineno)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            names = {getattr(node, "module", None), *(one.name for one in node.names)}
            if names & {"html", "jinja2", "escape"}:
                lines.append(node.lineno)
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        is_known = id(node) in docstrings or id(node) in trusted
        if is_text and not is_known and TAG.search(node.value):
            lines.append(node.lineno)
    return sorted(lines)


def test_other_ways_are_detected():
    assert html_of_other_means('x = f"<b>{name}</b>"') == [1, 1]
    assert html_of_other_means('x = "<b>"') == [1]
    assert html_of_other_means("x = Markup(name)") == [1]
    assert html_of_other_means("from html import escape") == [1]
    assert html_of_other_means("import html") == [1]
    assert html_of_other_means("from jinja2 import Template") == [1]
    assert html_of_other_means('x = f"a < {b}"') == []
    assert html_of_other_means("x = Markup(MARK)") == []


@pytest.mark.parametrize("package", ["tisfm.report", "tisfm.view"])
def test_there_is_one_way(package):
    # They look for tags in a page of viser, and in a drawing of Matplotlib.
    known = {"tisfm.view.static_page": 1, "tisfm.report.drawings": 2}
    for name, path in sources().items():
        if name.startswith(package):
            lines = html_of_other_means(path.read_text(encoding="utf-8"))
            assert len(lines) == known.get(name, 0), (name, lines)


def test_no_template_marks_a_text_as_safe():
    templates = [path for path in html._TEMPLATES.iterdir() if path.suffix in FILES]
    assert {path.suffix for path in templates} == FILES
    for path in templates:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"\|\s*safe\b|autoescape", text), path.name
        if path.suffix != ".html":
            assert "{{" not in text and "{%" not in text, path.name


def test_a_control_refuses_plain_text():
    from types import SimpleNamespace

    from markupsafe import Markup

    from tisfm.view.html_texts import set_html

    control = SimpleNamespace(content="")
    with pytest.raises(TypeError, match="expected Markup"):
        set_html(control, "<b>")
    set_html(control, Markup("<b>{}</b>").format("<i>\ud800"))
    assert control.content == "<b>&lt;i&gt;?</b>" and type(control.content) is str


def test_templates_escape_texts():
    evil = "<script>alert('1')</script>\"&"
    text = html.macro("view.html", "lines", "note", [evil], evil)
    assert text.count("&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt;&#34;&amp;") == 2
    assert "<script" not in text
