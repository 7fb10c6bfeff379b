"""Texts for a terminal hold no commands for it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tisfm.machine.text import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a b ü 日本 👩‍🚀.png", "a b ü 日本 👩‍🚀.png"),
        ("\x1b[2J\x1b]0;title\x07", r"\x1b[2J\x1b]0;title\x07"),
        ("\x9b31m\x7f\x00", r"\x9b31m\x7f\x00"),
        ("a\nb\rc\td\x85", r"a\nb\rc\td\x85"),
        ("\u202egnp.exe\u2066\u061c", r"\u202egnp.exe\u2066\u061c"),
        ("\udcff", "?"),
    ],
)
def test_a_command_becomes_text(text, shown):
    assert printable(text) == shown


@given(st.text(max_size=20))
def test_no_control_is_left(text):
    shown = printable(text)
    assert not any(ord(letter) < 32 or 127 <= ord(letter) < 160 for letter in shown)
    assert printable(shown) == shown
