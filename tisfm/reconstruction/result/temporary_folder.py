"""A folder that is deleted with the last reference to it."""

import shutil
import tempfile
import weakref


class TemporaryFolder:
    """A new folder, deleted when the last reference to this object goes, or when the process ends.

    `tempfile.TemporaryDirectory` would warn that it was not closed; here this is the normal end.
    """

    def __init__(self) -> None:
        self.name = tempfile.mkdtemp(prefix="tisfm-")  # path of the folder
        self._remove = weakref.finalize(self, shutil.rmtree, self.name, ignore_errors=True)

    def remove(self) -> None:
        """Delete the folder now."""
        self._remove()
