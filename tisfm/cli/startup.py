"""Parts of the command that need no library: exit codes, and the arguments of the doctor."""

from dataclasses import dataclass

# Exit codes beyond 0, success, and 1, an error that a line explains.
WRONG_OPTION = 2
INTERRUPTED = 130  # as shells count a program that SIGINT ended
BROKEN_PIPE = 141  # as shells count a program that SIGPIPE ended


@dataclass(kw_only=True)
class Doctor:
    """Find faults of the installation or of this machine, and say how to correct them.

    The command checks versions, conflicting builds of OpenCV, cores, memory, limits, Taichi and its
    cache of kernels, GPUs, folders and optional packages. The exit code is 1 after a fault.
    """

    json: bool = False
    """Print the findings as JSON, for scripts."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.doctor.examination import doctor

        return doctor(json=self.json)
