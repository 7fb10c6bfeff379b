"""Limits of the control groups that this process is in, of both versions that Linux has.

A group lies in others, and the smallest limit of all of them holds.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

_SELF = Path("/proc/self")
_OCTAL = re.compile(r"\\([0-7]{3})")  # how spaces are written in the list of mounts


@dataclass(frozen=True, kw_only=True)
class GroupLimits:
    """Limits that the groups set; None where they set none."""

    cores: float | None  # number of cores whose time the process may use
    memory: float | None  # bytes


def group_limits(process: Path = _SELF) -> GroupLimits:
    """Return the limits of a process, whose groups its folder in ``/proc`` lists.

    Without control groups, or if they cannot be read, there is no limit.
    """
    cores: list[float | None] = []
    memory: list[float | None] = []
    for folder, controllers in _groups(process):
        if controllers is None:
            cores.append(_share(folder / "cpu.max"))
            memory.append(_number(folder / "memory.max"))
        if controllers is not None and "cpu" in controllers:
            quota, period = (_number(folder / f"cpu.cfs_{name}_us") for name in ("quota", "period"))
            if quota is not None and quota > 0 and period:
                cores.append(quota / period)
        if controllers is not None and "memory" in controllers:
            memory.append(_number(folder / "memory.limit_in_bytes"))
    return GroupLimits(cores=_smallest(cores), memory=_smallest(memory))


def _groups(process: Path) -> Iterator[tuple[Path, set[str] | None]]:
    """Yield the folders of all groups, inner ones first, and their controllers; None for version 2.

    Version 1 has a tree of groups for each set of controllers, version 2 one for all.
    """
    mounts = list(_mounts(process))
    for line in _lines(process / "cgroup"):
        number, _, rest = line.partition(":")
        names, _, group = rest.partition(":")
        controllers = None if number == "0" and not names else set(names.split(","))
        for root, place, mounted in mounts:
            if (controllers is None) != (mounted is None):
                continue
            if controllers is not None and not controllers <= (mounted or set()):
                continue
            inside = _within(group, root)
            for part in (inside, *inside.parents):
                yield place / part, controllers


def _mounts(process: Path) -> Iterator[tuple[str, Path, set[str] | None]]:
    """Yield the group at the root of each mount, its folder, and its options; None in version 2."""
    for line in _lines(process / "mountinfo"):
        about, _, kind = line.partition(" - ")
        fields, kinds = about.split(), kind.split()
        if len(fields) < 5 or not kinds:
            continue
        root, place = (_OCTAL.sub(lambda one: chr(int(one[1], 8)), part) for part in fields[3:5])
        if kinds[0] == "cgroup2":
            yield root, Path(place), None
        elif kinds[0] == "cgroup":
            yield root, Path(place), set(kinds[-1].split(","))


def _within(group: str, root: str) -> PurePosixPath:
    """Return the path of a group in a mount; the mount itself if only that is visible."""
    path, top = PurePosixPath(group), PurePosixPath(root)
    if ".." in path.parts or not path.is_relative_to(top):
        return PurePosixPath()
    return path.relative_to(top)


def _share(path: Path) -> float | None:
    """Return the number of cores of ``cpu.max``, None if it sets no limit."""
    words = " ".join(_lines(path)).split()
    try:
        quota, period = map(float, words)
        return quota / period
    except (ValueError, ZeroDivisionError):  # "max 100000", or no such file
        return None


def _number(path: Path) -> float | None:
    try:
        return float(" ".join(_lines(path)))
    except ValueError:  # "max", or no such file
        return None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []


def _smallest(values: list[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)
