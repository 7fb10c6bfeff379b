"""Launching kernels: arguments are handed over once, and a launch may run again and again.

Taichi looks at each argument anew on every launch, for longer than a small grid takes to compute.
What its look can find, the wrappers of kernels have checked already.

There is one way: `Kernel.bind` hands arguments to a kernel and returns a `Launch`. A wrapper that
others want to keep is an `operation`: its `bind` checks the arguments and returns the launch,
and a call of it runs that at once.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any, Generic, ParamSpec, TypeVar

import taichi as ti

from tisfm.kernels.layout import internals

P = ParamSpec("P")
R = TypeVar("R")

_compiling = threading.Lock()  # Taichi does so in one thread at a time


class Launch:
    """A kernel and its arguments, to be run by a call, any number of times.

    Arrays are read and written where they lie, as they are at the time of the call; numbers are
    those of the time of binding. The arrays live as long as the launch.
    """

    __slots__ = ("_arguments", "_context", "_kernel", "_lasting", "_program", "_ready", "_run")

    def __init__(self, kernel: "Kernel", ready: tuple[Any, Any], arguments: tuple) -> None:
        self._kernel, self._ready, self._arguments = kernel, ready, arguments
        self._program = internals.program()
        self._run = internals.launcher(self._program)
        # Elsewhere than on a CPU, and with arrays of a device, a context is good for one launch.
        self._context, on_host = internals.context(ready[0], kernel.arguments, arguments)
        self._lasting = on_host and kernel.on_cpu

    def __call__(self) -> None:
        """Run the kernel.

        Raises
        ------
        RuntimeError
            If Taichi was started anew since the launch was bound.
        """
        if internals.program() is not self._program:
            raise RuntimeError(
                "Taichi was started anew since this launch was bound, and what it compiled is "
                "gone: bind it again"
            )
        context = self._context
        if not self._lasting:
            if context is None:
                context, _ = internals.context(
                    self._ready[0], self._kernel.arguments, self._arguments
                )
            self._context = None
        self._run(self._ready[1], context)


class Kernel:
    """A Taichi kernel.

    Arguments are NumPy arrays, C-contiguous and of the type that their annotation says, arrays of
    floats on the device (``ti.ndarray``), numbers, and values known while compiling
    (``ti.template()``). On a GPU, Taichi copies NumPy arrays there and back at every launch; on
    Vulkan and Metal, those that are only written are not copied there, and come back with anything
    where the kernel has left them alone.

    Parameters
    ----------
    function : callable
        What ``ti.kernel`` takes.

    Attributes
    ----------
    arguments : tisfm.kernels.layout.internals.Arguments
        What it takes.
    on_cpu : bool
        Whether the program that it was last compiled for runs on a CPU.
    """

    def __init__(self, function: Callable) -> None:
        self._call = ti.kernel(function)
        self._program: Any = None
        self.on_cpu = True
        self._compiled: dict[tuple, tuple[Any, Any]] = {}
        self.arguments = internals.Arguments(self._call)

    def __call__(self, *arguments: Any) -> None:
        """Run the kernel once with these arguments."""
        self.bind(*arguments)()

    def bind(self, *arguments: Any) -> Launch:
        """Return a launch with these arguments; the first for the same constants compiles it.

        Raises
        ------
        TypeError
            If there are more or fewer arguments than the kernel takes, or one is of another kind.
        """
        internals.check(self.arguments, arguments)
        program = internals.program()
        constants = tuple([arguments[index] for index in self.arguments.constants])
        if program is not self._program or constants not in self._compiled:
            with _compiling:
                ready = internals.compiled(self._call, arguments)
                if program is not self._program:
                    self._program, self._compiled = program, {}
                    self.on_cpu = internals.arch() == "cpu"
                self._compiled[constants] = ready
        return Launch(self, self._compiled[constants], arguments)


class Operation(Generic[P, R]):
    """A kernel's wrapper: a call runs it at once, and `bind` returns what runs it later."""

    def __init__(self, function: Callable[P, Callable[[], R]]) -> None:
        functools.update_wrapper(self, function)
        self._function = function

    def __call__(self, *arguments: P.args, **options: P.kwargs) -> R:
        """Check the arguments and run the kernel once."""
        return self._function(*arguments, **options)()

    def bind(self, *arguments: P.args, **options: P.kwargs) -> Callable[[], R]:
        """Check the arguments once; return what runs the kernel with them at every call."""
        return self._function(*arguments, **options)


def operation(function: Callable[P, Callable[[], R]]) -> Operation[P, R]:
    """Make an `Operation` of a function that checks its arguments and returns a launch."""
    return Operation(function)


def in_turn(*launches: Callable[[], Any]) -> Callable[[], None]:
    """Return what runs some launches, one after another."""

    def run() -> None:
        for launch in launches:
            launch()

    return run
