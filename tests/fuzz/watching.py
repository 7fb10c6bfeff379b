"""One input: whether the reader gave data or a clear error, in time and within memory."""

import sys
import time
from pathlib import Path

from tests.fuzz.targets import MIB, Target
from tisfm.formats import FormatError

try:
    import resource
except ImportError:  # on Windows: memory is not watched there
    resource = None

READ, REFUSED = "read", "refused"
_UNIT = 1 if sys.platform == "darwin" else 1024  # bytes


class Watch:
    """Has inputs read, one after the other."""

    def __init__(self) -> None:
        self._held = peak()

    def outcome(self, target: Target, path: Path) -> str:
        """Return "read", "refused", or what is wrong.

        Parameters
        ----------
        target : Target
        path : Path
            The input.
        """
        before, began = peak(), time.process_time()
        try:
            target.read(path)
            found = READ
        except target.raises as error:
            found, text = REFUSED, str(error)
            if isinstance(error, FormatError) and ("\n" in text or str(path.parent) not in text):
                found = f"unclear: {text!r}"
        except Exception as error:
            found = f"raised {type(error).__name__}: {error}"
        took, after = time.process_time() - began, peak()
        if took > target.seconds:
            return f"slow: {took:.1f} s"
        # The peak never falls: that of this input is known only if it is the highest so far.
        if after > before and after - self._held > target.memory:
            more, self._held = after - self._held, after
            return f"memory: {more / MIB:.0f} MiB"
        return found


def peak() -> int:
    """Return the most bytes that the process has held so far."""
    return 0 if resource is None else _UNIT * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
