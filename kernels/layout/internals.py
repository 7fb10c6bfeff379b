"""All uses of Taichi beyond its documented interface; docs/process.md lists them.

pyproject.toml pins the release of Taichi for this module. Before using another release, review this
module and run the tests `tests/kernels/test_launch.py` and `tests/test_process.py`.
"""

from typing import Any

import numpy as np
import taichi as ti
from taichi.lang import impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext
from taichi.lang.impl import expr_init

from tisfm.kernels.layout import CPU_ARCHS

bind = expr_init  # stores a value in a variable of the kernel, so that it is computed once

_FLOATS, _INTEGERS = (ti.f32, ti.f64), (ti.i32,)
_NUMPY: dict[str, Any] = {
    "f32": np.dtype(np.float32),
    "f64": np.dtype(np.float64),
    "i32": np.dtype(np.int32),
}


_describe_node = ASTTransformerContext.get_pos_info
_descriptions: dict[tuple, str] = {}


def _describe_node_once(context: Any, node: Any) -> str:
    """Return the source lines of a node, as Taichi shows them in its errors.

    Taichi formats these lines for every node that it compiles, many times for nodes in unrolled
    loops. That took half of the time of its front end, so here each node is formatted once.
    """
    position = node.lineno, node.col_offset, node.end_lineno, node.end_col_offset, type(node)
    key = context.file, context.lineno_offset, context.indent, context.func.func.__name__, *position
    if key not in _descriptions:
        _descriptions[key] = _describe_node(context, node)
    return _descriptions[key]


ASTTransformerContext.get_pos_info = _describe_node_once


def is_running() -> bool:
    """Return whether Taichi's runtime has been started."""
    return impl.get_runtime().prog is not None


def program() -> Any:
    """Return the running Taichi program; ``ti.init`` and ``ti.reset`` replace it."""
    return impl.pytaichi.prog


def configuration() -> Any:
    """Return the options of the running program, or of the next program."""
    return impl.current_cfg()


def arch() -> str:
    """Return the arch of the running program: "cpu", or Taichi's name of the arch."""
    name: str = impl.current_cfg().arch.name
    return "cpu" if name in CPU_ARCHS else name


def materialize() -> None:
    """Do the part of the start-up that ``ti.init`` leaves to the first kernel, in this thread."""
    impl.get_runtime().materialize()


def checks_indices() -> bool:
    """Return whether an application started Taichi with index checks; called while compiling."""
    return bool(impl.current_cfg().debug)


def subscript(array: Any, indices: list) -> Any:
    """Return an element of a kernel argument, while the kernel is compiled."""
    compiling = impl.get_runtime().compiling_callable
    return impl.subscript(compiling.ast_builder(), array, *indices)


def element_shape(array: Any) -> tuple[int, ...]:
    """Return the shape of the elements of a kernel argument, while the kernel is compiled."""
    shape: tuple[int, ...] = array.element_shape()
    return shape


class Arguments:
    """The arguments of a kernel by kind: their index in a call, and their slot.

    Slots count the arguments that are passed at a launch: all but constants.
    """

    def __init__(self, kernel: Any) -> None:
        self.names: list[str] = []
        self.annotations: list[Any] = []
        self.constants: list[int] = []  # indices of ``ti.template()`` arguments
        # (index, slot, end, dtype, ndim): an array has `ndim` axes of scalars of type `dtype`. If
        # its last axis holds the elements of vectors, `end` is −1, else None: ``shape[:end]`` has
        # no vector axis.
        self.arrays: list[tuple[int, int, int | None, Any, int]] = []
        self.floats: list[tuple[int, int]] = []  # (index, slot)
        self.integers: list[tuple[int, int]] = []
        slot = 0
        for index, argument in enumerate(kernel._primal.arguments):
            self.names.append(argument.name)
            kind = argument.annotation
            self.annotations.append(kind)
            if isinstance(kind, ti.template):
                self.constants.append(index)
                continue
            if any(kind is float_ for float_ in _FLOATS):
                self.floats.append((index, slot))
            elif any(kind is integer for integer in _INTEGERS):
                self.integers.append((index, slot))
            else:
                vector_axes = getattr(kind.dtype, "ndim", 0)  # 1 for vectors, 0 for scalars
                scalar = kind.dtype.dtype if vector_axes else kind.dtype
                dtype = _NUMPY[scalar.to_string()]
                self.arrays.append(
                    (index, slot, -vector_axes or None, dtype, kind.ndim + vector_axes)
                )
            slot += 1
        self.count = len(self.names)


def check(parameters: Arguments, arguments: tuple) -> None:
    """Raise unless the number of arguments and the types of arrays are those of a kernel.

    Raises TypeError if they are not: a kernel would overwrite memory beyond an array of another
    type.
    """
    if len(arguments) != parameters.count:
        raise TypeError(
            f"a kernel got {len(arguments)} arguments: expected {parameters.count}, "
            f"{', '.join(parameters.names)}"
        )
    for index, _, _, dtype, ndim in parameters.arrays:
        array = arguments[index]
        if isinstance(array, np.ndarray):
            if array.dtype == dtype and array.ndim == ndim and array.flags.c_contiguous:
                continue
            received = f"{array.dtype} of {array.ndim} axes"
            received += "" if array.flags.c_contiguous else ", not C-contiguous"
        elif isinstance(array, ti.Ndarray):
            continue
        else:
            received = type(array).__name__
        raise TypeError(
            f"{parameters.names[index]} is {received}: expected a C-contiguous array of {dtype} of "
            f"{ndim} axes"
        )


def compile_kernel(kernel: Any, arguments: tuple) -> tuple[Any, Any]:
    """Compile a kernel; return one object for `make_context`, then one for `launch_function`."""
    primal = kernel._primal
    compiled = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
    program_ = impl.get_runtime().prog
    return compiled, program_.compile_kernel(
        program_.config(), program_.get_device_caps(), compiled
    )


def launch_function(program_: Any) -> Any:
    """Return the function of a program that runs a compiled kernel with a context."""
    return program_.launch_kernel


def make_context(compiled: Any, parameters: Arguments, arguments: tuple) -> tuple[Any, bool]:
    """Return the context of a launch, with arrays by address, and whether all arrays are NumPy's.

    A context holds the arguments of a kernel.
    """
    launch_context, on_host = compiled.make_launch_context(), True
    for index, slot, end, _, _ in parameters.arrays:
        array = arguments[index]
        if isinstance(array, np.ndarray):
            address = array.__array_interface__["data"][0]
            launch_context.set_arg_external_array_with_shape(
                (slot,), address, array.nbytes, array.shape[:end], 0
            )
        else:
            launch_context.set_arg_ndarray((slot,), array.arr)
            on_host = False
    for index, slot in parameters.floats:
        launch_context.set_arg_float((slot,), float(arguments[index]))
    for index, slot in parameters.integers:
        launch_context.set_arg_int((slot,), int(arguments[index]))
    return launch_context, on_host
