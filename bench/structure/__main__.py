"""``python -m bench.structure [CHECKOUT …]``: packages, imports, cycles, lines, and calls.

The source of each checkout, by default this one, is read without running it, and drawn. Then one
interpretation of each motion is traced in a process of the checkout. bench/results gets a report
and a drawing, structure-NAME.md and .png, and for several checkouts a common table, structure.md.
"""

import argparse
import sys
from pathlib import Path

from bench.shared.results import RESULTS, ROOT
from bench.structure.drawing import draw
from bench.structure.report import comparison, markdown
from bench.structure.source import lines_by_folder, read
from bench.structure.way import Way, trace

MOTIONS = ("field", "camera", "objects")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.structure", description=__doc__)
    parser.add_argument("checkouts", nargs="*", type=Path, metavar="CHECKOUT")
    parser.add_argument("--names", nargs="+", help="of the checkouts; default: of their folders")
    parser.add_argument("--python", nargs="+", metavar="PATH", help="interpreters of the checkouts")
    parser.add_argument("--motion", nargs="*", choices=MOTIONS, default=MOTIONS, help="to follow")
    options = parser.parse_args(arguments)
    options.checkouts = options.checkouts or [ROOT]
    count = len(options.checkouts)
    options.names = options.names or [folder.resolve().name for folder in options.checkouts]
    options.python = options.python or [sys.executable] * count
    for name in ("names", "python"):
        if len(getattr(options, name)) != count:
            parser.error(f"--{name} has {len(getattr(options, name))} words for {count} checkouts")
    for folder in options.checkouts:
        if not (folder / "tisfm" / "__init__.py").is_file():
            parser.error(f"{folder} is no checkout of this project: it has no tisfm/__init__.py")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 2 if the code of a checkout cannot interpret a pair."""
    options = parse(arguments)
    RESULTS.mkdir(exist_ok=True)
    sources, ways = [], []
    for name, folder, python in zip(options.names, options.checkouts, options.python, strict=True):
        source = read(folder)
        try:
            way: dict[str, Way] = {m: trace(folder, Path(python), m) for m in options.motion}
        except (OSError, RuntimeError) as error:
            print(f"bench.structure: {error}", file=sys.stderr)
            return 2
        text = markdown(name, source, lines_by_folder(folder), way)
        path = RESULTS / f"structure-{name}.md"
        path.write_text(text, encoding="utf-8")
        draw(source, path.with_suffix(".png"), f"Packages and what they import: {name}")
        print(text)
        sources.append(source)
        ways.append(way)
    if len(sources) > 1:
        table = f"# Structure\n\n{comparison(options.names, sources, ways)}\n"
        (RESULTS / "structure.md").write_text(table, encoding="utf-8")
        print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
