"""The one-way layers and the other promises about the shape of the package."""

from __future__ import annotations

import ast
import graphlib
import re
import statistics
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "oed_sysid"

# Bottom to top: a module imports from layers before its own, or from its own folder.
LAYERS = (
    "errors",
    "runtime",
    "text",
    "physics",
    "data",
    "compiled",
    "experiments",
    "likelihood",
    "prediction",
    "information",
    "evidence",
    "export",
    "baselines",
    "design",
    "results",
    "testing",
    "cli",
    "app",
    "__main__",
)
# These speak to the user and therefore use the public API, as a user does.
USES_PUBLIC_API = (
    "testing",
    "app",
    "cli",
)
CASADI_LAYERS = (
    "text",
    "physics",
    "compiled",
    "experiments",
    "likelihood",
    "export",
    "baselines",
    "design",
)
MATPLOTLIB_LAYERS = ("results",)
FORBIDDEN_NAMES = ("utils", "util", "helpers", "helper", "common", "misc")
MEDIAN_LINES = 400


def modules(folder: Path) -> list[Path]:
    """Python files below a folder."""
    return sorted(p for p in folder.rglob("*.py") if "__pycache__" not in p.parts)


def layer_of(path: Path) -> str:
    """Name of the top-level module or folder of the package that holds a file."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


@cache
def imports(path: Path) -> tuple[tuple[int, str, tuple[str, ...]], ...]:
    """Line, absolute module and imported names of every import of a file."""
    return tuple(_imports(path))


def _imports(path: Path) -> Iterator[tuple[int, str, tuple[str, ...]]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name, ()
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if node.level:
                folder = path.parents[node.level - 1].relative_to(ROOT)
                module = ".".join((*folder.parts, *filter(None, [module])))
            yield node.lineno, module, tuple(alias.name for alias in node.names)


def package_layers(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and layer of every import from within the package."""
    for line, module, names in imports(path):
        head, _, tail = module.partition(".")
        if head != "oed_sysid":
            continue
        if tail:
            yield line, tail.split(".")[0]
        else:
            for name in names or ("oed_sysid",):
                yield line, name


PACKAGE_MODULES = [p for p in modules(PACKAGE) if p != PACKAGE / "__init__.py"]
ALL_MODULES = [
    path
    for folder in ("oed_sysid", "problems", "tests", "benchmarks", "examples")
    for path in modules(ROOT / folder)
]


def label(path: Path) -> str:
    """Path from the repository root, for test names and messages."""
    return path.relative_to(ROOT).as_posix()


def test_modules_belong_to_a_declared_layer() -> None:
    """Every module of the package has its place in the order of layers."""
    stray = sorted({layer_of(path) for path in PACKAGE_MODULES} - set(LAYERS))
    assert not stray, (
        f"{', '.join(stray)}: in no layer. Add them to LAYERS in tests/test_architecture.py, at "
        "the lowest place that their imports allow."
    )


def test_imports_go_downwards() -> None:
    """A module imports only from lower layers or from its own folder."""
    wrong = []
    for path in PACKAGE_MODULES:
        own = layer_of(path)
        allowed = {*LAYERS[: LAYERS.index(own) + 1], "__version__"}
        for line, layer in package_layers(path):
            if layer in allowed or (layer not in LAYERS and own in USES_PUBLIC_API):
                continue
            reason = "higher" if layer in LAYERS else "no layer; import the module that has it"
            wrong.append(f"{label(path)}:{line}: {layer} ({reason})")
    assert not wrong, "imports upwards:\n" + "\n".join(wrong)


@pytest.mark.parametrize(
    ("library", "layers"),
    [("casadi", CASADI_LAYERS), ("matplotlib", MATPLOTLIB_LAYERS), ("streamlit", ("app",))],
)
def test_library_is_confined(library: str, layers: tuple[str, ...]) -> None:
    """CasADi, matplotlib and streamlit are imported only in the layers that own them."""
    wrong = [
        f"{label(path)}:{line}"
        for path in modules(PACKAGE)
        for line, module, _ in imports(path)
        if module.split(".")[0] == library and layer_of(path) not in layers
    ]
    assert not wrong, f"{library} belongs in {', '.join(layers)}; found in {', '.join(wrong)}"


def test_modules_have_nouns() -> None:
    """No module is a drawer for leftovers."""
    drawers = [label(path) for path in ALL_MODULES if path.stem in FORBIDDEN_NAMES]
    assert not drawers, "name the nouns that these hold: " + ", ".join(drawers)


def test_median_module_is_short() -> None:
    """Half of the modules of the package are read on a few screens."""
    sizes = [len(path.read_text(encoding="utf-8").splitlines()) for path in modules(PACKAGE)]
    assert statistics.median(sizes) < MEDIAN_LINES


def test_named_numbers_say_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comment stands beside or above every named number: the page of the site shows both."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    from constants import constants

    numbers = {path: list(constants(path)) for path in PACKAGE.rglob("*.py")}
    assert sum(map(len, numbers.values())) > 100
    assert not [
        (path.name, name) for path, all_ in numbers.items() for name, _, why in all_ if not why
    ]


def test_problems_use_the_public_api_only() -> None:
    """A shipped problem is written as a user would write one."""
    wrong = []
    for path in sorted(ROOT.glob("problems/*/*.py")):
        for line, module, names in imports(path):
            head, *inner = module.split(".")
            if head in ("numpy", "scipy") or head in sys.stdlib_module_names:
                continue
            private = any(part.startswith("_") for part in (*inner, *names))
            if inner and (ROOT / head / Path(*inner)).with_suffix(".py").parent == path.parent:
                continue  # a module of the problem's own folder
            if head != "oed_sysid" or private or (inner and inner[0] not in LAYERS):
                wrong.append(f"{label(path)}:{line}: {module}")
    assert not wrong, "imports of more than the public API:\n" + "\n".join(wrong)


def test_sentences_keep_their_first_space() -> None:
    """A line that is continued in TOML loses the space that the next begins with."""
    files = [*PACKAGE.rglob("*.toml")]
    assert len(files) > 20
    lost = [file.name for file in files if re.search(r'"""\\\n[ \t]', file.read_text("utf-8"))]
    assert lost == []


@pytest.mark.parametrize(
    ("line", "heavy"),
    [
        ("import oed_sysid", "matplotlib pandas sklearn streamlit"),
        ("import oed_sysid.cli.application", "streamlit"),
        ("from oed_sysid.cli import main; main(['--help'])", "numpy casadi matplotlib"),
    ],
)
def test_import_is_light(line: str, heavy: str) -> None:
    """The package leaves plots and data frames alone, its help every numerical library."""
    code = f"import sys; {line}; print([m for m in {heavy.split()} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("[]")


def test_no_modules_import_each_other() -> None:
    """Imports make no circle, those for type checking and inside functions included."""
    known = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in modules(PACKAGE)
    }
    graph: dict[str, set[str]] = {}
    for name, path in known.items():
        graph[name] = set()
        for _, module, members in imports(path):
            parts = {f"{module}.{member}" for member in members}
            found = (parts & known.keys()) or ({module} & known.keys())
            # A package offers what its modules define: these, not its name, are imported.
            found = {one for one in found if known[one].name != "__init__.py"}
            graph[name] |= found - {name}
    graphlib.TopologicalSorter(graph).prepare()
