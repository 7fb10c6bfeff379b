"""Which files a source has, for processes on other machines, which are to see the same."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Listing:
    """How many files there are, and a digest of their names."""

    count: int
    digest: str

    @classmethod
    def of(cls, files: Sequence[Path]) -> "Listing":
        """Return that of files in their order."""
        names = "\0".join(path.name for path in files)
        return cls(len(files), hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest())

    def check(self, other: "Listing", title: str) -> None:
        """Refuse what another process sees, with RuntimeError, if it is not the same."""
        if other != self:
            raise RuntimeError(
                f"a worker sees other files in {title} ({other.count}) than the process that began "
                f"({self.count}): wait until all machines see the same, and give --resume"
            )
