"""List the benchmarks, or run some by name.

    python -m benchmarks [--list] [names | all]

Without names the quick ones run, about two minutes in all.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.harness import ONE_THREAD, command, known

FOLDER = Path(__file__).resolve().parent
QUICK = ("kernel", "information", "startup", "score", "growth", "swarm", "fit_speed")


def benchmarks() -> dict[str, str]:
    """First line of the docstring of every benchmark and of every part of ``speed``, by name."""
    files = [p for p in sorted(FOLDER.glob("*.py")) if p.stem != "__main__"]
    # What is not called by itself is part of these or of pages.
    paths = {p.stem: p for p in files if "\nif __name__ ==" in p.read_text("utf-8")}
    paths |= {p.parent.name: p for p in sorted(FOLDER.glob("*/__main__.py"))}
    trees = {name: ast.parse(path.read_text("utf-8")) for name, path in paths.items()}
    parts = [
        node
        for node in trees["speed"].body
        if isinstance(node, ast.FunctionDef) and "Measured" in ast.unparse(node.returns or node)
    ]
    texts = {name: ast.get_docstring(tree) or "" for name, tree in trees.items()}
    texts |= {part.name: ast.get_docstring(part) or "" for part in parts}
    return {name: text.partition("\n")[0] for name, text in texts.items()}


def main(names: Sequence[str] = QUICK, *, list: bool = False) -> int:
    """Run what is asked for; return the number of benchmarks that failed.

    Parameters
    ----------
    names : sequence of str
        of those that are listed, or all
    list : bool
        only list them
    """
    found = benchmarks()
    chosen = [*found] if [*names] == ["all"] else [known(n, found, "benchmark") for n in names]
    for name, text in found.items():
        print(f"{'*' if name in chosen and not list else ' '} {name:18} {text}")
    failed = []
    for name in () if list else chosen:
        print(f"\n== {name}", flush=True)
        is_file = (FOLDER / f"{name}.py").exists() or (FOLDER / name).is_dir()
        words = [f"benchmarks.{name}"] if is_file else ["benchmarks.speed", name]
        ran = subprocess.run([sys.executable, "-m", *words], env={**os.environ, **ONE_THREAD})
        failed += [name] * bool(ran.returncode)
    if failed:
        print(f"\nfailed: {', '.join(failed)}")
    return len(failed)


if __name__ == "__main__":
    sys.exit(command(main))
