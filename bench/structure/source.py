"""Modules of a checkout, the imports between them, cycles, and lines of code."""

import ast
import io
import tokenize
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOTS = {"tisfm": "tisfm", "kernels": "tisfm.kernels"}  # folder → name of the installed package
FOLDERS = ("tisfm", "kernels", "bench", "tests")
BASE = " (base)"
_NO_CODE = (
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER,
)  # fmt: skip
Graph = Mapping[str, frozenset[str]]  # name → names that it imports


@dataclass(frozen=True, kw_only=True)
class Module:
    """A file of source: its dotted name, package, lines of code, and the modules it imports.

    `types` are modules that it imports for annotations only.
    """

    name: str
    package: str
    lines: int
    imports: frozenset[str]
    types: frozenset[str]


@dataclass(frozen=True)
class Source:
    """All modules of the package and of the kernels of a checkout, by name."""

    modules: Mapping[str, Module]

    @cached_property
    def graph(self) -> Graph:
        """Module → modules that it imports anywhere in its code, except for annotations only."""
        return {name: module.imports for name, module in self.modules.items()}

    @cached_property
    def packages(self) -> Graph:
        """Package → other packages that it imports modules of."""
        return self.grouped({name: module.package for name, module in self.modules.items()})

    def grouped(self, groups: Mapping[str, str]) -> Graph:
        """Return the imports between groups of modules."""
        found: dict[str, set[str]] = {group: set() for group in groups.values()}
        for name, imports in self.graph.items():
            found[groups[name]] |= {groups[other] for other in imports} - {groups[name]}
        return {group: frozenset(others) for group, others in found.items()}

    @cached_property
    def rooms(self) -> dict[str, str]:
        """Module → the box of the drawing that contains it.

        The box is its package. In a cycle of packages, modules that import nothing from the other
        packages of the cycle get a separate box below, such as settings that every stage reads.
        """
        packages = {name: module.package for name, module in self.modules.items()}
        rooms = dict(packages)
        for cycle in cycles(self.packages):
            within = {name for name, package in packages.items() if package in cycle}
            for name in within - self.packages.keys():  # an __init__ stays with its package
                needed = reachable(self.graph, name) & within
                if all(packages[other] == packages[name] for other in needed):
                    rooms[name] = f"{packages[name]}{BASE}"
        # Boxes that contain all of a package have the plain name of the package.
        split = set(packages.values()) & set(rooms.values())
        return {
            name: room if packages[name] in split else packages[name]
            for name, room in rooms.items()
        }


def read(folder: Path) -> Source:
    """Return the modules of a checkout."""
    files = {}
    for root, package in ROOTS.items():
        for path in sorted((folder / root).rglob("*.py")):
            parts = path.relative_to(folder / root).with_suffix("").parts
            inner = parts[:-1] if parts[-1] == "__init__" else parts
            files[".".join((package, *inner))] = path
    modules = {}
    for name, path in files.items():
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        types = frozenset(
            node for test in ast.walk(tree) if _for_types(test) for node in ast.walk(test)
        )
        used = {False: set[str](), True: set[str]()}
        for node in ast.walk(tree):
            used[node in types] |= {
                target for target in _targets(node, package, files) if target != name
            }
        modules[name] = Module(
            name=name,
            package=package,
            lines=code_lines(text),
            imports=frozenset(used[False]),
            types=frozenset(used[True] - used[False]),
        )
    return Source(modules)


def _for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def _targets(node: ast.AST, package: str, known: Iterable[str]) -> set[str]:
    """Return the known modules that a statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names} & set(known)
    if not isinstance(node, ast.ImportFrom):
        return set()
    base = node.module or ""
    if node.level:
        outer = package.split(".")[: len(package.split(".")) - node.level + 1]
        base = ".".join([*outer, *filter(None, [node.module])])
    found = {f"{base}.{alias.name}" for alias in node.names}
    submodules = found & set(known)
    rest = {base} & set(known) if len(submodules) < len(found) else set()
    return submodules | rest


def code_lines(text: str) -> int:
    """Return the number of lines with code: no docstrings, comments or empty lines."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def lines_by_folder(folder: Path) -> dict[str, int]:
    """Return the lines of code in every folder with Python files, without its subfolders."""
    found: dict[str, int] = {}
    for top in FOLDERS:
        for path in sorted((folder / top).rglob("*.py")):
            place = path.parent.relative_to(folder).as_posix()
            lines = code_lines(path.read_text(encoding="utf-8"))
            found[place] = found.get(place, 0) + lines
    return found


def reachable(graph: Graph, start: str) -> set[str]:
    """Return all names that a name imports, directly or indirectly."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        for other in graph[waiting.pop()] - found:
            found.add(other)
            waiting.append(other)
    return found


def cycles(graph: Graph) -> list[frozenset[str]]:
    """Return the sets of names that import one another, directly or indirectly."""
    reach = {name: reachable(graph, name) for name in graph}
    found = {
        frozenset(other for other in reach[name] if name in reach[other])
        for name in graph
        if name in reach[name]
    }
    return sorted(found, key=sorted)


def storeys(graph: Graph) -> dict[str, int]:
    """Return the layer of every name: 0 without imports, else one above its highest import.

    Names of one cycle are in the same layer.
    """
    circle = {name: cycle for cycle in cycles(graph) for name in cycle}
    found: dict[str, int] = {}

    def storey(name: str) -> int:
        if name not in found:
            together = circle.get(name, frozenset({name}))
            below = frozenset().union(*(graph[member] for member in together)) - together
            height = max((storey(other) + 1 for other in below), default=0)
            found.update(dict.fromkeys(together, height))
        return found[name]

    for name in graph:
        storey(name)
    return found
