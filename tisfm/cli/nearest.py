"""What somebody may have meant who wrote a word that is unknown."""

import difflib
from collections.abc import Iterable

_ALIKE = 0.6  # share of the letters, as difflib counts


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that is most like another; None if none is like it."""
    words = [name for name in known if name]
    begun = [name for name in words if name.startswith(word)] if word.strip("-") else []
    if len(begun) == 1:
        return begun[0]
    lower = {name.lower(): name for name in reversed(words)}
    found = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=_ALIKE)
    return lower[found[0]] if found else None


def hint(word: str, known: Iterable[str]) -> str:
    """Return the nearest word as part of an error; nothing if none is like it."""
    found = nearest(word, known)
    return f", did you mean {found!r}?" if found else ""
