"""Limits of the control groups that this process is in, of both versions that Linux has.

A group lies in others, and the smallest limit of all of them holds.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

_OWN_PROCESS = Path("/proc/self")
_OCTAL_ESCAPE = re.compile(r"\\([0-7]{3})")  # how spaces are written in the list of mounts


@dataclass(frozen=True, kw_only=True)
class GroupLimits:
    """Limits that the groups set; None where they set none."""

    cores: float | None  # number of cores whose time the process may use
    memory: float | None  # bytes


def group_limits(process: Path = _OWN_PROCESS) -> GroupLimits:
    """Return the limits of a process by its folder in ``/proc``, which lists its groups.

    Without control groups, or if they cannot be read, there is no limit.
    """
    cores: list[float | None] = []
    memory: list[float | None] = []
    for folder, controllers in _find_groups(process):
        if controllers is None:
            cores.append(_read_core_limit(folder / "cpu.max"))
            memory.append(_read_number(folder / "memory.max"))
        if controllers is not None and "cpu" in controllers:
            quota, period = (
                _read_number(folder / f"cpu.cfs_{name}_us") for name in ("quota", "period")
            )
            if quota is not None and quota > 0 and period:
                cores.append(quota / period)
        if controllers is not None and "memory" in controllers:
            memory.append(_read_number(folder / "memory.limit_in_bytes"))
    return GroupLimits(cores=_smallest(cores), memory=_smallest(memory))


def _find_groups(process: Path) -> Iterator[tuple[Path, set[str] | None]]:
    """Yield the folders of all groups, inner ones first, and their controllers; None for version 2.

    Version 1 has a tree of groups for each set of controllers, version 2 one for all.
    """
    mounts = list(_read_mounts(process))
    for line in _read_lines(process / "cgroup"):
        number, _, rest = line.partition(":")
        names, _, group = rest.partition(":")
        controllers = None if number == "0" and not names else set(names.split(","))
        for root, mount_folder, mount_controllers in mounts:
            if (controllers is None) != (mount_controllers is None):
                continue
            if controllers is not None and not controllers <= (mount_controllers or set()):
                continue
            path_in_mount = _path_in_mount(group, root)
            for ancestor in (path_in_mount, *path_in_mount.parents):
                yield mount_folder / ancestor, controllers


def _read_mounts(process: Path) -> Iterator[tuple[str, Path, set[str] | None]]:
    """Yield the group at the root of each mount, its folder, and its options; None in version 2."""
    for line in _read_lines(process / "mountinfo"):
        mount_fields, _, type_text = line.partition(" - ")
        fields, type_fields = mount_fields.split(), type_text.split()
        if len(fields) < 5 or not type_fields:
            continue
        root, mount_folder = (
            _OCTAL_ESCAPE.sub(lambda match: chr(int(match[1], 8)), part) for part in fields[3:5]
        )
        if type_fields[0] == "cgroup2":
            yield root, Path(mount_folder), None
        elif type_fields[0] == "cgroup":
            yield root, Path(mount_folder), set(type_fields[-1].split(","))


def _path_in_mount(group: str, root: str) -> PurePosixPath:
    """Return the path of a group in a mount; the mount's own folder if the group is outside it."""
    path, top = PurePosixPath(group), PurePosixPath(root)
    if ".." in path.parts or not path.is_relative_to(top):
        return PurePosixPath()
    return path.relative_to(top)


def _read_core_limit(path: Path) -> float | None:
    """Return the number of cores of ``cpu.max``, None if it sets no limit."""
    words = " ".join(_read_lines(path)).split()
    try:
        quota, period = map(float, words)
        return quota / period
    except (ValueError, ZeroDivisionError):  # "max 100000", or no such file
        return None


def _read_number(path: Path) -> float | None:
    try:
        return float(" ".join(_read_lines(path)))
    except ValueError:  # "max", or no such file
        return None


def _read_lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []


def _smallest(values: list[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)
