"""``tisfm doctor``: its arguments."""

from dataclasses import dataclass


@dataclass(kw_only=True)
class Doctor:
    """Say what is wrong with the installation or this machine, and what to do.

    Looks at versions, builds of OpenCV that clash, cores, memory, limits, Taichi and its cache of
    kernels, GPUs, folders and optional packages. The exit code is 1 if something is broken.
    """

    json: bool = False
    """Print JSON, for scripts."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.doctor.examination import doctor

        return doctor(json=self.json)
