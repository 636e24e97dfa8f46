"""List the benchmarks, or run some by name.

    python -m benchmarks [--list] [names | all]

Without names the quick ones run, about two minutes in all.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import subprocess
import sys
from pathlib import Path

from benchmarks.harness import ONE_THREAD

FOLDER = Path(__file__).resolve().parent
QUICK = ("kernel", "information", "startup", "score", "growth", "swarm", "fit_speed")
# A part of ``speed`` and what it measures, in the docstring.
PART = re.compile(r"^(\w+)\n    (.+)$", re.MULTILINE)
PARTS = ("__init__", "__main__", "harness", "kinematics", "rates", "truth")


def benchmarks() -> dict[str, str]:
    """First line of the docstring of every benchmark, by name."""
    paths = {p.stem: p for p in sorted(FOLDER.glob("*.py")) if p.stem not in PARTS}
    paths |= {p.parent.name: p for p in sorted(FOLDER.glob("*/__main__.py"))}
    texts = {
        name: ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
        for name, path in paths.items()
    }
    found = {name: text.partition("\n")[0] for name, text in texts.items()}
    return found | dict(PART.findall(texts["speed"]))


def main() -> int:
    """Run what is asked for; return the number of benchmarks that failed."""
    known = benchmarks()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", default=list(QUICK))
    parser.add_argument("--list", action="store_true", help="only list them")
    options = parser.parse_args()
    names = list(known) if options.names == ["all"] else options.names
    if unknown := [name for name in names if name not in known]:
        parser.error(f"no benchmark {unknown[0]!r}; there are {', '.join(known)}")
    for name, text in known.items():
        print(f"{'*' if name in names and not options.list else ' '} {name:18} {text}")
    if options.list:
        return 0
    failed = []
    for name in names:
        print(f"\n== {name}", flush=True)
        is_file = (FOLDER / f"{name}.py").exists() or (FOLDER / name).is_dir()
        words = [f"benchmarks.{name}"] if is_file else ["benchmarks.speed", name]
        command = [sys.executable, "-m", *words]
        if subprocess.run(command, env={**os.environ, **ONE_THREAD}, check=False).returncode:
            failed.append(name)
    if failed:
        print(f"\nfailed: {', '.join(failed)}")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
