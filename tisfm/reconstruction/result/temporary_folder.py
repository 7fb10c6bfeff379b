"""A folder that is deleted with the last reference to it."""

import shutil
import tempfile
import weakref


class TemporaryFolder:
    """A new folder, deleted once nothing refers to this object, or with the process.

    `tempfile.TemporaryDirectory` warns where it is not closed before; here that is how it ends.

    Attributes
    ----------
    name : str
        Its path.
    """

    def __init__(self) -> None:
        self.name = tempfile.mkdtemp(prefix="tisfm-")
        self._remove = weakref.finalize(self, shutil.rmtree, self.name, ignore_errors=True)

    def remove(self) -> None:
        """Delete it now."""
        self._remove()
