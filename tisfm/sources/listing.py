"""Which files a source has, for processes on other machines, which are to see the same."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Listing:
    """How many files there are, and a digest of their names, and of their sizes if these count."""

    count: int
    digest: str

    @classmethod
    def of(cls, files: Sequence[Path], *, with_sizes: bool = False) -> "Listing":
        """Return that of files in their order."""
        sizes = [f"/{path.stat().st_size}" if with_sizes else "" for path in files]
        names = "\0".join(f"{path.name}{size}" for path, size in zip(files, sizes, strict=True))
        return cls(len(files), hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest())

    def check(self, other: "Listing", title: str) -> None:
        """Refuse what another process sees, with RuntimeError, if it is not the same."""
        if other != self:
            raise RuntimeError(
                f"a worker sees other files in {title} ({other.count}) than the process that began "
                f"({self.count}): wait until all machines see the same, and give --resume"
            )
