"""Launches of kernels: arguments are bound once, and the launch can run many times.

Taichi itself inspects all arguments at every launch, which takes longer than the computation on a
small grid. Here the wrappers of kernels check the arguments instead, once.

`Kernel.bind` binds arguments to a kernel and returns a `Launch`. A wrapper function decorated with
`operation` checks its arguments: its `bind` returns the launch, and calling it runs the launch at
once.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any, Generic, ParamSpec, TypeVar

import taichi as ti

from tisfm.kernels.layout import internals

P = ParamSpec("P")
R = TypeVar("R")

_compiling = threading.Lock()  # Taichi can compile in one thread at a time only


class Launch:
    """A kernel with bound arguments; a call runs it, any number of times.

    A call reads and writes the arrays themselves, with their values at the time of the call. Number
    arguments keep their values from the time of binding. The launch keeps its arrays alive.
    """

    __slots__ = (
        "_arguments",
        "_compiled_kernel",
        "_context",
        "_is_reusable",
        "_kernel",
        "_program",
        "_run",
    )

    def __init__(self, kernel: "Kernel", compiled: tuple[Any, Any], arguments: tuple) -> None:
        self._kernel, self._compiled_kernel, self._arguments = kernel, compiled, arguments
        self._program = internals.program()
        self._run = internals.launch_function(self._program)
        # On a GPU, or with arrays on a device, a context is valid for one launch only.
        self._context, on_host = internals.make_context(compiled[0], kernel.arguments, arguments)
        self._is_reusable = on_host and kernel.on_cpu

    def __call__(self) -> None:
        """Run the kernel.

        Raises RuntimeError if Taichi was restarted after the launch was bound.
        """
        if internals.program() is not self._program:
            raise RuntimeError(
                "Taichi was restarted after this launch was bound, and its compiled kernels are "
                "gone: bind the launch again"
            )
        context = self._context
        if not self._is_reusable:
            if context is None:
                context, _ = internals.make_context(
                    self._compiled_kernel[0], self._kernel.arguments, self._arguments
                )
            self._context = None
        self._run(self._compiled_kernel[1], context)


class Kernel:
    """A Taichi kernel.

    Arguments are NumPy arrays, C-contiguous and of the annotated type, arrays of floats on the
    device (``ti.ndarray``), numbers, and values known while compiling (``ti.template()``). On a
    GPU, Taichi copies NumPy arrays to the device and back at every launch. On Vulkan and Metal,
    arrays that the kernel only writes are not copied to the device, so elements that the kernel
    does not write come back with arbitrary values.
    """

    def __init__(
        self,
        function: Callable,  # a function for ``ti.kernel``
    ) -> None:
        self._call = ti.kernel(function)
        self._program: Any = None
        # whether the program for which the kernel was last compiled runs on a CPU
        self.on_cpu = True
        self._compiled: dict[tuple, tuple[Any, Any]] = {}
        self.arguments = internals.Arguments(self._call)  # the arguments of the kernel

    def __call__(self, *arguments: Any) -> None:
        """Run the kernel once with these arguments."""
        self.bind(*arguments)()

    def bind(self, *arguments: Any) -> Launch:
        """Return a launch with these arguments; compile the kernel if its constants are new.

        Raises TypeError if the number of arguments or the type of an array is wrong.
        """
        internals.check(self.arguments, arguments)
        program = internals.program()
        constants = tuple([arguments[index] for index in self.arguments.constants])
        if program is not self._program or constants not in self._compiled:
            with _compiling:
                compiled = internals.compile_kernel(self._call, arguments)
                if program is not self._program:
                    self._program, self._compiled = program, {}
                    self.on_cpu = internals.arch() == "cpu"
                self._compiled[constants] = compiled
        return Launch(self, self._compiled[constants], arguments)


class Operation(Generic[P, R]):
    """A wrapper of a kernel: a call runs the kernel, `bind` returns a launch for later."""

    def __init__(self, function: Callable[P, Callable[[], R]]) -> None:
        functools.update_wrapper(self, function)
        self._function = function

    def __call__(self, *arguments: P.args, **options: P.kwargs) -> R:
        """Check the arguments and run the kernel once."""
        return self._function(*arguments, **options)()

    def bind(self, *arguments: P.args, **options: P.kwargs) -> Callable[[], R]:
        """Check the arguments once; return a launch that runs the kernel with them."""
        return self._function(*arguments, **options)


def operation(function: Callable[P, Callable[[], R]]) -> Operation[P, R]:
    """Make an `Operation` from a function that checks its arguments and returns a launch."""
    return Operation(function)


def join_launches(*launches: Callable[[], Any]) -> Callable[[], None]:
    """Return a function that runs the launches one after another."""

    def run() -> None:
        for launch in launches:
            launch()

    return run
