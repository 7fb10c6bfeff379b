"""Errors whose text is written for the user: it says what is wrong and what to do.

Any other exception, such as one that NumPy or Taichi raises, is a bug of tisfm: its traceback is
needed.
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
    """An error of tisfm that its user can mend.

    Each class below is also a built-in exception, so that ``except ValueError`` finds it.

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


class OutOfMemoryError(TisfmError, MemoryError):
    """Memory or address space does not suffice."""


def is_user_error(error: BaseException) -> bool:
    """Return whether the user can mend an error, so that its text suffices without a traceback.

    An OSError is the answer of the operating system, a MemoryError that of the machine, whichever
    library raised it.
    """
    return isinstance(error, (TisfmError, OSError, MemoryError))
