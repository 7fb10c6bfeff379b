"""The imports of all modules of the project, read from the sources."""

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {"tisfm": ROOT / "tisfm", "tisfm.kernels": ROOT / "kernels"}


def sources():
    """Return module → path; a package has the path of its ``__init__``."""
    found = {}
    for top, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join((top, *parts)).removesuffix(".__init__")] = path
    return found


def imports_of(name, path, modules):
    """Return the names that a module imports, except under ``TYPE_CHECKING``.

    A name of one of `modules` is complete; other names are as the source has them.
    """
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    waiting = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            whole = {alias.name: f"{base}.{alias.name}" for alias in node.names}
            found |= {full if full in modules else base for full in whole.values()}
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting += node.orelse
        else:
            waiting += ast.iter_child_nodes(node)
    return found


@cache
def import_graph():
    """Return module → names of the modules that it imports."""
    modules = sources()
    return {name: imports_of(name, path, modules) for name, path in modules.items()}


def package_of(name, modules):
    """Return the package of a module; a module of the top level is a package of its own."""
    if name not in modules or modules[name].name == "__init__.py":
        return name
    above = name.rpartition(".")[0]
    return name if above == "tisfm" else above


def cycles(edges):
    """Return the groups of nodes that reach each other, and the nodes that reach themselves."""

    def reached(start):
        seen, waiting = set(), [start]
        while waiting:
            for node in edges.get(waiting.pop(), ()):
                if node not in seen:
                    seen.add(node)
                    waiting.append(node)
        return seen

    reach = {node: reached(node) for node in edges}
    found = {
        frozenset(other for other in reach[node] if node in reach.get(other, ()))
        for node in edges
        if node in reach[node]
    }
    return sorted(sorted(cycle) for cycle in found)


def allowed_imports(package, modules):
    """Read from a package's docstring what it may import: the names after "May import:".

    Returns a pair: the packages and modules named, and whether all others of `tisfm` are allowed
    instead ("all of `tisfm` but …").
    """
    doc = ast.get_docstring(ast.parse(modules[package].read_text(encoding="utf-8"))) or ""
    words = doc.partition("May import:")[2]
    assert words, f"the docstring of {package} does not say what it may import"
    words = words.split("\n\n")[0]
    everything = "all of `tisfm`" in words
    named = set(re.findall(r"`([\w.]+)`", words)) - {"tisfm"}
    named = {name if name.startswith("tisfm.") else f"tisfm.{name}" for name in named}
    for name in re.findall(r"what `([\w.]+)` may", words):
        named |= allowed_imports(name, modules)[0]
    unknown = sorted(name for name in named if name not in modules)
    assert not unknown, f"the docstring of {package} allows {unknown}: there is no such module"
    return named, everything


def forbidden_imports(package, modules, imports):
    """Return the imports of a package that its docstring does not allow, as "module → module"."""
    named, everything = allowed_imports(package, modules)
    found = []
    for name in modules:
        if package_of(name, modules) != package:
            continue
        for other in sorted(imports[name]):
            if other.partition(".")[0] != "tisfm" or package_of(other, modules) == package:
                continue
            parts = other.split(".")
            if other == "tisfm.errors":  # every package may raise them
                continue
            prefixes = {".".join(parts[:n]) for n in range(2, len(parts) + 1)}
            if bool(prefixes & named) is everything:
                found.append(f"{name} → {other}")
    return found
