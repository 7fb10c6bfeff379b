"""How much of the surface points and meshes keep, from options of commands."""

from tisfm.errors import InputError
from tisfm.fusion.agreement import Coverage


def chosen_coverage(complete: bool, strict: bool) -> Coverage:
    """Return the coverage that two options choose; ValueError if both are given."""
    if complete and strict:
        raise InputError("--complete excludes --strict: leave out one of them")
    return "complete" if complete else "strict" if strict else "normal"
