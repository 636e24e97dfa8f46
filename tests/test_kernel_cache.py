"""Compiled code on disk: reused, rebuilt when torn, shared by processes, optional."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from oed_sysid.compiled import compile as compiling

ROOT = Path(__file__).resolve().parent.parent
PROGRAM = """
import sys
import numpy as np
from vehicles import roll_oscillator
from oed_sysid.compiled.kernels import Kernel
model = roll_oscillator()
times = 0.1 * np.arange(50)
for _ in range(2):
    kernel = Kernel(model)
    start = np.array([0.3, 0.0])
    run = kernel.run(times, 0 * times[:, None], model.value_vector, start, sensitivities=True)
print(kernel.is_compiled, repr(float(run.outputs.sum() + run.output_sensitivities.sum())))
"""


def begin(cache: Path, **environment: str) -> subprocess.Popen[str]:
    """Start a fresh process that runs one model."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env=os.environ | {"OED_SYSID_CACHE": str(cache), "PYTHONPATH": path} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Output and messages of a process that must succeed."""
    out, messages = process.communicate(timeout=120)
    assert process.returncode == 0, messages
    return out.strip(), messages


def test_code_is_compiled_once(tmp_path: Path) -> None:
    """The first process compiles and says so; the second finds the library."""
    first, said = finish(begin(tmp_path))
    assert said.count("compiling the equations of 'roll'") == 1
    second, quiet = finish(begin(tmp_path))
    assert "compiling" not in quiet
    assert first == second
    assert first.startswith("True")
    assert len(list(tmp_path.glob("*.so"))) == 1
    assert not [p for p in tmp_path.iterdir() if p.is_dir()]


@pytest.mark.parametrize("damage", ["truncate", "no digest", "empty"])
def test_torn_library_is_rebuilt(tmp_path: Path, damage: str) -> None:
    """A damaged library is never loaded; it is built again."""
    good, _ = finish(begin(tmp_path))
    (library,) = tmp_path.glob("*.so")
    if damage == "no digest":
        library.with_suffix(".sha256").unlink()
    else:
        library.write_bytes(library.read_bytes()[: 5000 if damage == "truncate" else 0])
    again, said = finish(begin(tmp_path))
    assert "compiling" in said
    assert again == good


def test_processes_compile_at_the_same_time(tmp_path: Path) -> None:
    """Three processes that need the same code at once all get it."""
    processes = [begin(tmp_path) for _ in range(3)]
    results = [finish(process)[0] for process in processes]
    assert len(set(results)) == 1
    assert "compiling" not in finish(begin(tmp_path))[1]


def test_without_a_compiler_the_interpreter_runs(tmp_path: Path) -> None:
    """Without a compiler the numbers are the same, and this is said once."""
    compiled, _ = finish(begin(tmp_path))
    interpreted, said = finish(begin(tmp_path, OED_SYSID_COMPILER="none"))
    assert interpreted.startswith("False")
    assert said.count("Models run in CasADi's interpreter") == 1
    assert float(interpreted.split()[1]) == pytest.approx(float(compiled.split()[1]), rel=1e-12)


def test_cache_that_cannot_be_written(tmp_path: Path) -> None:
    """Where the cache cannot be written the interpreter runs and says why."""
    occupied = tmp_path / "file"
    occupied.write_text("not a folder")
    result, said = finish(begin(occupied))
    assert result.startswith("False")
    assert "cannot be written" in said


def test_changed_source_is_another_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Text and flags of a source enter its name: neither a stale nor a needless compilation."""
    monkeypatch.setenv("OED_SYSID_CACHE", str(tmp_path))

    def answer(text: str, *flags: str) -> int:
        library = compiling.load_source("answer", lambda: text, what="a number", flags=flags)
        assert library is not None
        return library.answer()

    assert answer("int answer(void) { return 1; }") == 1
    assert answer("int answer(void) { return 2; }") == 2
    assert answer("int answer(void) { return ANSWER; }", "-DANSWER=3") == 3
    assert answer("int answer(void) { return ANSWER; }", "-DANSWER=4") == 4
    assert capfd.readouterr().err.count("compiling") == 4
    assert answer("int answer(void) { return 1; }") == 1
    assert "compiling" not in capfd.readouterr().err


def test_models_depend_on_their_own_source_only() -> None:
    """The name of a model's library depends on the C files it may include and on no other."""
    native = ROOT / "oed_sysid" / "compiled"
    included = set(re.findall(r'"(\w+\.c)"', (native / "generate.py").read_text()))
    included &= {path.name for path in native.glob("*.c")}
    counted = {Path(name).name for name in compiling._GENERATOR if name.endswith(".c")}
    assert counted == included == {"trajectory.c", "filter.c"}
