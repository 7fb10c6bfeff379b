"""HTML from templates of Jinja, which escape every text put into them.

Here: the templates of the report and of the viewer. Only values of the type `Markup` are not
escaped: HTML that a template returned, and drawings that Matplotlib escapes.
May import: nothing of `tisfm`.
"""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

_TEMPLATES = Path(__file__).parent


def render(name: str, **values: Any) -> Markup:
    """Return a template filled with values, such as a whole page."""
    return Markup(_environment().get_template(name).render(**values))


def macro(name: str, part: str, *values: Any) -> Markup:
    """Return a part of a page: the macro of a template, called with values."""
    return Markup(getattr(_environment().get_template(name).module, part)(*values))


@cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
