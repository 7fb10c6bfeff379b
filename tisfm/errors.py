"""Errors with a text for the user: the text says what is wrong and what to do.

Any other exception, for example from NumPy or Taichi, is a bug of tisfm, and a report of the bug
needs its traceback.
"""

__all__ = [
    "InputError",
    "InputTypeError",
    "MissingPackageError",
    "OutOfMemoryError",
    "OutOfRangeError",
    "RunError",
    "TisfmError",
]


class TisfmError(Exception):
    """An error that the user of tisfm can fix.

    Each class below is also a built-in exception, so ``except ValueError`` catches an `InputError`.

    Examples
    --------
    >>> import tisfm
    >>> try:
    ...     tisfm.Camera(focal=-1.0)
    ... except tisfm.errors.TisfmError as error:
    ...     print(error)
    focal is -1: the focal length must be positive, in px
    """


class InputError(TisfmError, ValueError):
    """An argument, an option or a file has a value that tisfm cannot use."""


class InputTypeError(TisfmError, TypeError):
    """An argument is of the wrong type."""


class OutOfRangeError(TisfmError, IndexError):
    """A frame or a pixel with this number does not exist."""


class RunError(TisfmError, RuntimeError):
    """The process or the machine does not allow the computation."""


class MissingPackageError(TisfmError, ModuleNotFoundError):
    """An optional package is not installed, or lacks a feature."""


class OutOfMemoryError(MemoryError, TisfmError):  # in the other order unpickling fails
    """There is not enough memory or address space."""


def is_user_error(error: BaseException) -> bool:
    """Return whether the user can fix an error, so that its text is enough without a traceback.

    OSError and MemoryError count, whichever library raised them: they come from the operating
    system and the machine, not from a bug.
    """
    return isinstance(error, (TisfmError, OSError, MemoryError))
