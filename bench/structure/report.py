"""The report on the source of a checkout, as Markdown."""

from collections.abc import Mapping, Sequence

from bench.structure.source import Graph, Source, cycles, storeys
from bench.structure.way import Way

KERNELS = "tisfm.kernels"
# Modules with values that every stage uses; without them, only the stages are left.
VALUES = ("camera", "settings", "runtime", "interpretation", "checks", "rigid", "cores")
STAGES = "stages"
MOST_ENTERED = 6
MOST_LINES = 150  # of a listed call path


def in_kernels(module: str) -> bool:
    """Return whether a module belongs to the kernels."""
    return module == KERNELS or module.startswith(KERNELS + ".")


def short(module: str) -> str:
    """Return the name of a module without the prefix ``tisfm.``."""
    return module.removeprefix("tisfm.")


def markdown(name: str, source: Source, lines: Mapping[str, int], ways: Mapping[str, Way]) -> str:
    """Return the report on one checkout; `ways` is motion → calls, and may be empty."""
    parts = [
        [f"# Structure: {name}", "", f"![rooms](structure-{name}.png)", "", *_counts(source)],
        ["", "## Cycles", "", *_cycles(source)],
        ["", "## Lines of code, without docstrings, comments and empty lines", "", *_lines(lines)],
    ]
    if ways:
        parts.append(["", "## The way of a frame", "", *_ways(ways)])
    return "\n".join(line for part in parts for line in part) + "\n"


def _counts(source: Source) -> list[str]:
    rooms = source.grouped(source.rooms)
    direct = [n for n, m in source.modules.items() if m.package == "tisfm" != n]
    return [
        f"- {len(source.graph)} modules on {_height(source.graph)} storeys, with "
        f"{_arrows(source.graph)} imports between them; {len(direct)} of them directly in tisfm/",
        f"- {len(source.packages)} packages, with {_arrows(source.packages)} imports between them",
        f"- {len(rooms)} rooms of the drawing on {_height(rooms)} storeys: of packages that import "
        "one another, the modules that need none of the others are a room of their own",
    ]


def _height(graph: Graph) -> int:
    return 1 + max(storeys(graph).values())


def _arrows(graph: Graph) -> int:
    return sum(map(len, graph.values()))


def _cycles(source: Source) -> list[str]:
    annotated = {name: source.graph[name] | m.types for name, m in source.modules.items()}
    found = []
    for what, graph in (
        ("modules", source.graph),
        ("modules, with imports for annotations alone", annotated),
        ("packages", source.packages),
        ("rooms", source.grouped(source.rooms)),
    ):
        listed = "; ".join(", ".join(sorted(cycle)) for cycle in cycles(graph))
        found.append(f"- of {what}: {listed or 'none'}")
    for cycle in cycles(source.grouped(source.rooms)):
        found += ["", f"Imports between {', '.join(sorted(cycle))}:", ""]
        for name in sorted(source.graph):
            others = {
                other
                for other in source.graph[name]
                if source.rooms[other] in cycle - {source.rooms[name]}
            }
            if source.rooms[name] in cycle and others:
                found.append(f"- {short(name)} → {', '.join(map(short, sorted(others)))}")
    return found


def _lines(lines: Mapping[str, int]) -> list[str]:
    tops = dict.fromkeys(folder.partition("/")[0] for folder in lines)
    total = {top: sum(n for f, n in lines.items() if f.partition("/")[0] == top) for top in tops}
    rows = []
    for top in tops:
        rows.append(f"| **{top}** | **{total[top]}** |")
        rows += [f"| {f} | {n} |" for f, n in lines.items() if f.partition("/")[0] == top]
    return ["| folder | lines |", "| --- | ---: |", *rows]


def views(way: Way) -> dict[str, Way]:
    """Return the calls with all modules, without kernels, and of the stages only."""
    alone = way.without(in_kernels)
    return {
        "tisfm and kernels": way,
        "tisfm": alone,
        STAGES: alone.without(lambda module: short(module) in VALUES),
    }


def _ways(ways: Mapping[str, Way]) -> list[str]:
    lines = [
        "A stop is each time that another module executes, by a call or by the return to a caller. "
        "Preset balanced, 120×160. Folded: calls that follow one another several times count once. "
        f"Stages: without kernels and without {', '.join(VALUES)}.",
        "",
        "| motion | of | modules | stops | back up | folded: stops | back up | most entered |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | --- |",
    ]
    for motion, way in ways.items():
        for what, seen in views(way).items():
            once = seen.folded()
            most = once.entered.most_common(MOST_ENTERED)
            words = ", ".join(f"{short(module)} {times}" for module, times in most)
            lines.append(
                f"| {motion} | {what} | {len(seen.entered)} | {seen.stops} | {seen.back} "
                f"| {once.stops} | {once.back} | {words} |"
            )
    for motion, way in ways.items():
        written = list(views(way)[STAGES].folded().lines(short))
        more = len(written) - MOST_LINES
        rest = [f"… and {more} lines more"] if more > 0 else []
        lines += ["", f"{motion}, stages, folded:", ""]
        lines += ["```text", *written[:MOST_LINES], *rest, "```"]
    return lines


def comparison(
    names: Sequence[str], sources: Sequence[Source], ways: Sequence[Mapping[str, Way]]
) -> str:
    """Return a table of several checkouts side by side."""
    rows: list[tuple[str, list[object]]] = [
        ("modules", [len(s.modules) for s in sources]),
        ("storeys of modules", [_height(s.graph) for s in sources]),
        ("imports between modules", [_arrows(s.graph) for s in sources]),
        ("packages", [len(s.packages) for s in sources]),
        ("imports between packages", [_arrows(s.packages) for s in sources]),
        ("cycles of packages", [len(cycles(s.packages)) for s in sources]),
    ]
    for motion in ways[0]:
        stages = [views(w[motion])[STAGES] for w in ways]
        rows += [
            (f"{motion}: stages' modules", [len(w.entered) for w in stages]),
            (f"{motion}: stops, folded", [w.folded().stops for w in stages]),
            (f"{motion}: of these back up", [w.folded().back for w in stages]),
        ]
    lines = ["|  | " + " | ".join(names) + " |", "| --- |" + " ---: |" * len(names)]
    return "\n".join(lines + [f"| {what} | " + " | ".join(map(str, v)) + " |" for what, v in rows])
