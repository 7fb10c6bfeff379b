"""Whether an error was foreseen, and tells its user what to do, or is a bug of ours."""

import dis

_PACKAGE = __name__.partition(".")[0]
_RAISE = dis.opmap["RAISE_VARARGS"]


def is_stated(error: BaseException) -> bool:
    """Return whether the text of an error was written for the user.

    It was where a ``raise`` statement of tisfm raised it. What NumPy or Taichi raises, or an
    operation on values that nobody checked, is a bug: its traceback is needed. An OSError is the
    system's answer and a MemoryError the machine's, whoever raised them.

    Parameters
    ----------
    error : BaseException
        As it was caught, with its traceback.
    """
    if isinstance(error, (OSError, MemoryError)):
        return True
    if not isinstance(error, (TypeError, ValueError, IndexError, RuntimeError, ImportError)):
        return False
    return is_raised_here(error)


def is_raised_here(error: BaseException) -> bool:
    """Return whether a ``raise`` statement of tisfm raised an error."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return False
    module = str(trace.tb_frame.f_globals.get("__name__"))
    code = trace.tb_frame.f_code.co_code
    return module.partition(".")[0] == _PACKAGE and code[trace.tb_lasti] == _RAISE
