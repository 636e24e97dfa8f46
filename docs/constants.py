"""A page with every named number of the package: its value and the comment that says why."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "oed_sysid"


def _is_number(value: ast.expr | None) -> bool:
    """Whether an expression is a number, or a tuple of numbers, written out."""
    if isinstance(value, ast.UnaryOp):
        return _is_number(value.operand)
    if isinstance(value, ast.BinOp):
        return _is_number(value.left) and _is_number(value.right)
    if isinstance(value, ast.Tuple):
        return bool(value.elts) and all(map(_is_number, value.elts))
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def _remark(lines: list[str], first: int, last: int) -> str:
    """The comment behind a statement, or the lines of comment directly above it."""
    behind = re.search(r"#\s*(.+)$", lines[last - 1])
    if behind:
        return behind[1]
    above: list[str] = []
    for line in reversed(lines[: first - 1]):
        if not line.strip().startswith("#"):
            break
        above.insert(0, line.strip().lstrip("# "))
    return " ".join(above)


def constants(path: Path) -> Iterator[tuple[str, str, str]]:
    """Name, value and comment of each named number of a module or of its classes."""
    text = path.read_text(encoding="utf-8")
    lines, tree = text.splitlines(), ast.parse(text)
    bodies = [tree.body, *(node.body for node in tree.body if isinstance(node, ast.ClassDef))]
    for node in (node for body in bodies for node in body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or not _is_number(node.value):
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        name = ast.unparse(target).strip("()")
        if name.lstrip("_").isupper() and node.value is not None:
            remark = _remark(lines, node.lineno, node.end_lineno or node.lineno)
            yield name, ast.unparse(node.value), remark


def page() -> list[str]:
    """Lines of the page, one table for each room of the package."""
    title = "Every number that decides"
    lines = [title, "=" * len(title), ""]
    words = (
        "Read from the source when this site is built: each named number, where it stands and why."
    )
    lines += [words, ""]
    for room in sorted(path for path in PACKAGE.iterdir() if path.is_dir()):
        rows = [
            (f"``{name} = {value}``", f"``{path.name}``", remark)
            for path in sorted(room.rglob("*.py"))
            for name, value, remark in constants(path)
        ]
        if not rows:
            continue
        lines += [room.name, "-" * len(room.name), "", ".. list-table::", "   :header-rows: 1"]
        lines += ["   :widths: 35 20 45", ""]
        for cells in [("number", "file", "why"), *rows]:
            escaped = (*cells[:2], re.sub(r"([*|\\_`])", r"\\\1", cells[2]))
            lines += [f"   {' ' if i else '*'} - {cell}" for i, cell in enumerate(escaped)]
        lines += [""]
    return lines
