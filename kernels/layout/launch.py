"""Launching kernels without Taichi's own checks of every argument.

Taichi looks at each argument anew on every launch, for longer than a small grid takes to compute.
What its look can find, the wrappers of kernels have checked already.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

_compiling = threading.Lock()  # Taichi does so in one thread at a time
FLOATS, INTEGERS = (ti.f32, ti.f64), (ti.i32,)


class _Recording(threading.local):
    """What `Replay` records in this thread, if it does."""

    launches: list[Callable[[], None]] | None = None


_recording = _Recording()


class Replay:
    """Calls a function once, and then only launches the kernels again that it launched.

    They find the arrays and numbers of the first call: arrays are read and written where they
    lie, as `Kernel.bound` says, and what else the function does is not repeated. On a CPU; calls
    on a device are left as they are.

    Parameters
    ----------
    function : callable
        Without arguments.
    on_device : bool
        Whether its arrays lie on a device.
    """

    def __init__(self, function: Callable[[], Any], *, on_device: bool = False) -> None:
        self._function, self._on_device = function, on_device
        self._launches: list[Callable[[], None]] | None = None
        self._result: Any = None

    def __call__(self) -> Any:
        """Return what the first call returned."""
        if self._on_device:
            return self._function()
        if self._launches is None:
            launches: list[Callable[[], None]] = []
            _recording.launches = launches
            try:
                self._result = self._function()
            finally:
                _recording.launches = None
            self._launches = launches
        else:
            for launch in self._launches:
                launch()
        return self._result


class Kernel:
    """A Taichi kernel, called like one.

    Arguments are NumPy arrays, C-contiguous and of the type that their annotation says, arrays of
    floats on the device (``ti.ndarray``), numbers, and values known while compiling
    (``ti.template()``). On a GPU, Taichi copies NumPy arrays there and back at every launch; on
    Vulkan and Metal, those that are only written are not copied there, and come back with anything
    where the kernel has left them alone.

    Parameters
    ----------
    function : callable
        What ``ti.kernel`` takes.
    """

    def __init__(self, function) -> None:
        self._call = ti.kernel(function)
        self._program: Any = None
        self._compiled: dict[tuple, tuple[Any, Any]] = {}
        self._constants: list[int] = []
        self._arrays: list[tuple[int, int, int | None]] = []
        self._floats: list[tuple[int, int]] = []
        self._integers: list[tuple[int, int]] = []
        slot = 0
        for index, argument in enumerate(self._call._primal.arguments):
            kind = argument.annotation
            if isinstance(kind, ti.template):
                self._constants.append(index)
                continue
            if any(kind is real for real in FLOATS):
                self._floats.append((index, slot))
            elif any(kind is whole for whole in INTEGERS):
                self._integers.append((index, slot))
            else:
                element = getattr(kind.dtype, "ndim", 0)  # axes of a vector
                self._arrays.append((index, slot, -element or None))
            slot += 1

    def __call__(self, *arguments) -> None:
        """Run the kernel; the first call for the same constants compiles it."""
        if _recording.launches is not None:
            launch = self.bound(*arguments)
            _recording.launches.append(launch)
            launch()
            return
        program = ti.lang.impl.get_runtime().prog
        if program is not self._program:
            self._program, self._compiled = program, {}
        constants = tuple([arguments[index] for index in self._constants])
        known = self._compiled.get(constants)
        if known is None:
            with _compiling:
                self._call(*arguments)
                self._compiled[constants] = self._prepared(arguments)
            return
        kernel, compiled = known
        program.launch_kernel(compiled, self._context(kernel, arguments))

    def bound(self, *arguments) -> Callable[[], None]:
        """Return a launch with these arguments, arrays and numbers as they are now.

        It saves what handing over the arguments takes, for whoever launches often, on a CPU. Arrays
        are read and written where they lie, and must not be replaced.
        """
        program = ti.lang.impl.get_runtime().prog
        constants = tuple([arguments[index] for index in self._constants])
        if program is not self._program or constants not in self._compiled:
            with _compiling:
                prepared = self._prepared(arguments)
            if program is not self._program:
                self._program, self._compiled = program, {}
            self._compiled[constants] = prepared
        kernel, compiled = self._compiled[constants]
        context = self._context(kernel, arguments)

        def launch(_arguments=arguments) -> None:  # which keeps the arrays alive
            program.launch_kernel(compiled, context)

        return launch

    def _context(self, kernel: Any, arguments: tuple) -> Any:
        """Return the context of a launch."""
        context = kernel.make_launch_context()
        for index, slot, axes in self._arrays:
            array = arguments[index]
            if isinstance(array, np.ndarray):
                address = array.__array_interface__["data"][0]
                context.set_arg_external_array_with_shape(
                    (slot,), address, array.nbytes, array.shape[:axes], 0
                )
            else:
                context.set_arg_ndarray((slot,), array.arr)
        for index, slot in self._floats:
            context.set_arg_float((slot,), float(arguments[index]))
        for index, slot in self._integers:
            context.set_arg_int((slot,), int(arguments[index]))
        return context

    def _prepared(self, arguments: tuple) -> tuple[Any, Any]:
        """Return the kernel that a call with such arguments has compiled, as launches need it."""
        primal = self._call._primal
        program = ti.lang.impl.get_runtime().prog
        kernel = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
        compiled = program.compile_kernel(program.config(), program.get_device_caps(), kernel)
        return kernel, compiled
