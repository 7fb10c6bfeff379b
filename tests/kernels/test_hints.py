"""Every function of the kernels says what it takes and gives, but Taichi's own."""

import ast
from pathlib import Path

import pytest

from tisfm import kernels

TAICHI = {"func", "kernel", "lane_kernel", "Kernel"}


def functions():
    for path in sorted(Path(kernels.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = {getattr(d, "attr", getattr(d, "id", "")) for d in node.decorator_list}
                if not names & TAICHI:
                    yield pytest.param(node, id=f"{path.stem}.{node.name}")


@pytest.mark.parametrize("node", list(functions()))
def test_a_function_has_type_hints(node):
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    arguments += [a for a in (node.args.vararg, node.args.kwarg) if a]
    bare = [a.arg for a in arguments if a.annotation is None and a.arg not in ("self", "cls")]
    assert not bare and node.returns is not None
