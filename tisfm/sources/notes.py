"""Notes on how a source is read, as warnings."""

import warnings
from collections.abc import Iterable


class SourceWarning(UserWarning):
    """Files or streams are left out, frames are resampled, or names or times are read in one way.

    Examples
    --------
    >>> import warnings
    >>> from tisfm.sources.notes import SourceWarning
    >>> warnings.simplefilter("ignore", SourceWarning)
    """


def warn_of(notes: Iterable[str], *, stacklevel: int = 2) -> None:
    """Give each note as a `SourceWarning` at the caller, or further up, as `warnings.warn` does."""
    for note in notes:
        warnings.warn(note, SourceWarning, stacklevel=stacklevel + 1)
