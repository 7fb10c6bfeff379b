"""One input: whether the reader gave data or a clear error, in time and within memory."""

import time
from pathlib import Path

from tests.fuzz.targets import MIB, Target
from tisfm.formats import FormatError

READ, REFUSED = "read", "refused"
_CLEAR, _STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")


def outcome(target: Target, path: Path) -> str:
    """Return "read", "refused", or what is wrong.

    Parameters
    ----------
    target : Target
    path : Path
        The input.
    """
    before, began = _held(), time.process_time()
    try:
        target.read(path)
        found = READ
    except target.raises as error:
        found = REFUSED
        text = str(error)
        if isinstance(error, FormatError) and ("\n" in text or str(path.parent) not in text):
            found = f"unclear: {text!r}"
    except Exception as error:
        found = f"raised {type(error).__name__}: {error}"
    took = time.process_time() - began
    more = _peak() - before
    if took > target.seconds:
        return f"slow: {took:.1f} s"
    if more > target.memory:
        return f"memory: {more / MIB:.0f} MiB"
    return found


def _held() -> int:
    """Return the bytes that the process holds, and start its peak from there, where Linux is."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return 0
    return _bytes("VmRSS:")


def _peak() -> int:
    return _bytes("VmHWM:") if _CLEAR.exists() else 0


def _bytes(name: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    return 0
