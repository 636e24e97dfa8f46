"""Trajectories and sensitivities: compiled, interpreted, by differences; code on disk."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motion import small
from scipy.integrate import solve_ivp
from vehicles import remus, roll_oscillator

from benchmarks import truth
from oed_sysid import Model
from oed_sysid import physics as effects
from oed_sysid.compiled import compile as compiling
from oed_sysid.compiled.filtering import filter_kernel
from oed_sysid.compiled.kernels import Kernel, Run, kernel
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.filtered import active_components, disturbed_model

START = np.array([1.5, 0.02, 0.01, 0.05, 10.0])


@pytest.fixture(scope="module", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Compiled code of these tests stays in a folder of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OED_SYSID_CACHE", str(tmp_path_factory.mktemp("kernels")))
        yield


def rich() -> Model:
    """Vehicle with memory at every stage: actuator, fluid and sensor."""
    chain = (
        effects.actuator_lag("fin_lag", "ds", value=0.2),
        effects.backlash("play", "ds", value=0.02),
        effects.current_forward(value=0.1),
        effects.fluid_memory("memory", "Z", "w", value=-15.0),
        effects.sensor_bias("bias", "z", "m", scale=1.0, value=0.3),
        effects.sensor_lag("depth_lag", "z", value=0.25),
    )
    return remus() + chain


def test_a_part_of_a_larger_kernel_runs_as_its_own() -> None:
    """A study compiles once: every smaller model is run by the library of all candidates."""
    whole, times = rich(), np.linspace(0.0, 6.0, 121)
    gone = ("play", "memory", "depth_lag")
    absent, model = [e for e in whole.effects if e.name in gone], whole.without(*gone)
    wide = filter_kernel(disturbed_model(model + [e.absent() for e in absent], ()))
    part, own = wide.part(model, active_components(wide.model, model)), kernel(model)
    inputs, values, starts = commands(times), model.value_vector, np.arange(0, 121, 30)
    z, dz = own.start(START, inputs[0], values, 0.0)
    for found, expected in zip(part.start(START, inputs[0], values, 0.0), (z, dz), strict=True):
        assert np.allclose(found, expected, atol=1e-12)
    nodes = own.run(times, inputs, values, z).states[starts]
    runs = [
        one.run(times, inputs, values, nodes, starts=starts, sensitivities=True)
        for one in (part, own)
    ]
    assert_same(*runs, atol=1e-9)


def commands(times: np.ndarray) -> np.ndarray:
    """Fin doublets and a thrust that steps, ``(n_times, 2)``."""
    fin = 0.1 * np.sign(np.sin(0.9 * times)) + 0.03 * np.sin(3 * times)
    return np.column_stack([fin, 9.0 + (times > 3)])


def run(model: Model, times: np.ndarray, *, compiled: bool, sensitivities: bool = True) -> Run:
    """Run one record from the common start."""
    machine = Kernel(model, compiled=compiled)
    inputs = commands(times)
    z, _ = machine.start(START, inputs[0], model.value_vector, times[0])
    return machine.run(times, inputs, model.value_vector, z, sensitivities=sensitivities)


def assert_same(a: Run, b: Run, *, atol: float) -> None:
    """Compare everything that two runs return."""
    assert a.failed_at == b.failed_at
    for name in ("outputs", "states", "output_sensitivities", "ends", "end_sensitivities"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=atol, err_msg=name)


@pytest.mark.parametrize("spacing", [0.1, 0.25])
def test_compiled_equals_interpreted(spacing: float) -> None:
    """Generated C and CasADi's interpreter give the same numbers, substeps included."""
    times = 2.0 + spacing * np.arange(60)
    compiled, interpreted = (run(rich(), times, compiled=flag) for flag in (True, False))
    assert_same(compiled, interpreted, atol=1e-11)


def test_start_and_its_derivatives() -> None:
    """The start puts memory at rest, and knows how it depends on states and parameters."""
    model = rich()
    first = commands(np.zeros(1))[0]
    z, dz = Kernel(model, compiled=True).start(START, first, model.value_vector, 0.0)
    z_i, dz_i = Kernel(model, compiled=False).start(START, first, model.value_vector, 0.0)
    np.testing.assert_allclose(z, [*START, 0.02, first[0], first[0], 10.3, 10.3], atol=1e-15)
    np.testing.assert_allclose(z_i, z)
    np.testing.assert_allclose(dz_i, dz)
    bias = model.free_names.index("E_bias")
    np.testing.assert_allclose(dz[-2:, 5 + bias], 1.0)


def test_sensitivities_equal_finite_differences() -> None:
    """Derivatives by start states and free parameters equal central differences."""
    model, times = rich(), 0.1 * np.arange(50)
    machine, inputs, values = Kernel(model, compiled=True), commands(times), model.value_vector
    z, _ = machine.start(START, inputs[0], values, 0.0)
    exact = machine.run(times, inputs, values, z, sensitivities=True).output_sensitivities
    columns = [(z, index) for index in range(machine.n_full)]
    columns += [(values, model.parameter_names.index(name)) for name in model.free_names]
    assert exact.shape[2] == len(columns)
    for column, (target, index) in enumerate(columns):
        kept, step = target[index], 1e-6 * max(1.0, abs(target[index]))
        sides = []
        for sign in (1, -1):
            target[index] = kept + sign * step
            sides.append(machine.run(times, inputs, values, z).outputs)
        target[index] = kept
        difference = (sides[0] - sides[1]) / (2 * step)
        np.testing.assert_allclose(exact[:, :, column], difference, atol=2e-6, rtol=1e-5)


def by_hand(times: np.ndarray) -> np.ndarray:
    """States at the samples by an adaptive integrator, ``(n_times, 5)``."""
    inputs, states = commands(times), [START]
    for k in range(len(times) - 1):
        step = solve_ivp(
            lambda _, x, *command: truth.rates(x, command, truth.TRUE, np.sin, np.cos),
            (times[k], times[k + 1]), states[-1], "DOP853", args=inputs[k], rtol=1e-11, atol=1e-12,
        )  # fmt: skip
        states.append(step.y[:, -1])
    return np.array(states)


def test_trajectory_equals_an_independent_one() -> None:
    """The model's text, its graph and its integrator agree with hand-written equations."""
    times = np.concatenate([0.1 * np.arange(40), [4.03, 4.3, 4.31, 5.0]])
    reference = by_hand(times)
    fine = run(replace(remus(), step=0.01), times, compiled=True, sensitivities=False)
    np.testing.assert_allclose(fine.outputs, reference, atol=1e-8)


def test_integration_is_of_fourth_order() -> None:
    """Halving the step divides the error by about sixteen."""
    times = 0.4 * np.arange(12)
    reference = by_hand(times)
    errors = [
        np.abs(run(replace(remus(), step=h), times, compiled=True).outputs - reference).max()
        for h in (0.2, 0.1, 0.05)
    ]
    assert 10 < errors[0] / errors[1] < 24
    assert 10 < errors[1] / errors[2] < 24


@pytest.mark.parametrize("compiled", [True, False])
def test_what_is_not_taken_from_nodes_goes_on(compiled: bool) -> None:
    """Own states from nodes at every sample, memory from the step before: the whole run again."""
    model, times = rich(), 0.1 * np.arange(40)
    whole = run(model, times, compiled=compiled)
    machine, nodes = Kernel(model, compiled=compiled), whole.states.copy()
    assert machine.n_full > machine.n_own
    nodes[1:, machine.n_own :] = np.nan  # which are not read
    parts = machine.run(
        times, commands(times), model.value_vector, nodes,
        starts=np.arange(40), from_nodes=machine.n_own,
    )  # fmt: skip
    np.testing.assert_allclose(parts.states, whole.states, atol=1e-12)


@pytest.mark.parametrize("compiled", [True, False])
def test_segments_join_to_the_continuous_run(compiled: bool) -> None:
    """Segments that start on the trajectory reproduce it; their derivatives chain."""
    model, times = rich(), 0.1 * np.arange(40)
    whole = run(model, times, compiled=compiled)
    machine, inputs, values = Kernel(model, compiled=compiled), commands(times), model.value_vector
    starts = np.array([0, 7, 8, 30])
    nodes = whole.states[starts]
    parts = machine.run(times, inputs, values, nodes, starts=starts, sensitivities=True)
    carried = machine.run(
        times, inputs, values, nodes[:1], starts=starts, from_nodes=0, sensitivities=True
    )
    np.testing.assert_allclose(parts.outputs, whole.outputs, atol=1e-12)
    np.testing.assert_allclose(parts.ends[:-1], nodes[1:], atol=1e-12)
    assert_same(carried, parts, atol=1e-9)
    assert parts.end_sensitivities is not None
    n, total = machine.n_full, np.eye(machine.n_full, machine.n_columns)
    for block in parts.end_sensitivities:
        moved = block[:, :n] @ total
        moved[:, n:] += block[:, n:]
        total = moved
    np.testing.assert_allclose(total, whole.end_sensitivities[0], atol=1e-9)


def accumulator(interpolation: str, step: float = 0.1) -> Model:
    """Integral of the input, with a known decay."""
    law, decay = {"x": "u - k*x"}, {"k [1/s]": 0.0}
    how = {"interpolation": interpolation, "step": step}
    return small("accumulator", "x [m] <- u [m/s]", law, decay, **how)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("step", [1.0, 0.07])
def test_hold_and_linear_inputs(compiled: bool, step: float) -> None:
    """A held input integrates to rectangles, a linear one to trapezia, however sampled."""
    times = np.array([0.0, 0.3, 0.35, 1.0, 1.8])
    inputs = np.array([1.0, -2.0, 4.0, 0.5, 3.0])
    rectangles = np.cumsum(np.append(0, inputs[:-1] * np.diff(times)))
    trapezia = np.cumsum(np.append(0, 0.5 * (inputs[:-1] + inputs[1:]) * np.diff(times)))
    for interpolation, expected in (("hold", rectangles), ("linear", trapezia)):
        machine = Kernel(accumulator(interpolation, step), compiled=compiled)
        result = machine.run(times, inputs[:, None], np.zeros(1), np.zeros(1))
        np.testing.assert_allclose(result.outputs[:, 0], expected, atol=1e-12)


def test_irregular_sampling_of_a_decay() -> None:
    """Samples at any spacing lie on the exact solution, and so do their derivatives."""
    times = np.cumsum([0.0, 0.013, 0.4, 0.1, 1.1, 0.002])
    machine = Kernel(accumulator("hold", 0.01), compiled=True)
    zeros = np.zeros((len(times), 1))
    result = machine.run(times, zeros, np.array([0.8]), np.ones(1), sensitivities=True)
    exact = np.exp(-0.8 * times)
    np.testing.assert_allclose(result.outputs[:, 0], exact, atol=1e-10)
    np.testing.assert_allclose(result.output_sensitivities[:, 0, 0], exact, atol=1e-10)
    np.testing.assert_allclose(result.output_sensitivities[:, 0, 1], -times * exact, atol=1e-9)


def test_linear_input_through_the_whole_chain() -> None:
    """A rolling ship under a measured moment: compiled, interpreted and exact agree."""
    model = replace(roll_oscillator(), step=0.05)
    times = 0.1 * np.arange(200)
    moment = 0.1 * np.sin(1.3 * times)[:, None]
    start = np.array([0.2, 0.0])
    results = []
    for compiled in (True, False):
        machine = Kernel(model, compiled=compiled)
        results.append(machine.run(times, moment, model.value_vector, start, sensitivities=True))
    assert_same(*results, atol=1e-11)

    def rolling(t: float, x: np.ndarray) -> list[float]:
        acting = np.interp(t, times, moment[:, 0]) - 0.2 * x[1] - 2 * np.sin(x[0])
        return [x[1], acting / 2]

    accuracy = {"rtol": 1e-9, "atol": 1e-10, "max_step": 0.05}
    exact = solve_ivp(rolling, (0, times[-1]), start, "RK45", times, **accuracy)
    np.testing.assert_allclose(results[0].outputs, exact.y.T, atol=1e-6)


@pytest.mark.parametrize("compiled", [True, False])
def test_failure_is_reported_where_it_happens(compiled: bool) -> None:
    """A trajectory that overflows is finite before the stated sample and NaN after."""
    model = small("explosion", "x [m]", {"x": "x**2"})
    times = 0.1 * np.arange(60)
    result = Kernel(model, compiled=compiled).run(
        times, np.zeros((60, 0)), np.zeros(0), np.ones(1), sensitivities=True
    )
    assert not result.ok
    assert 10 < result.failed_at < 30
    assert np.isfinite(result.outputs[: result.failed_at]).all()
    assert np.isnan(result.outputs[result.failed_at :]).all()
    assert np.isnan(result.output_sensitivities[result.failed_at :]).all()


@pytest.mark.parametrize("compiled", [True, False])
def test_one_sample_is_a_measurement(compiled: bool) -> None:
    """A record of one sample measures the initial state."""
    result = run(rich(), np.array([3.0]), compiled=compiled)
    assert result.ok
    np.testing.assert_allclose(result.outputs[0], [*START[:4], 10.3])


def test_kernel_is_shared_and_travels() -> None:
    """One structure has one kernel, and a kernel survives a trip to another process."""
    model = rich()
    assert kernel(model) is kernel(model.with_values({"E_play": 0.01}))
    assert pickle.loads(pickle.dumps(kernel(model))) is kernel(model)


def test_wrong_shapes_are_refused() -> None:
    """Too few values or nodes are named before anything runs."""
    model, times = remus(), 0.1 * np.arange(4)
    machine, inputs = Kernel(model, compiled=False), commands(times)
    with pytest.raises(ModelError, match="parameter values"):
        machine.run(times, inputs, np.zeros(3), START)
    with pytest.raises(ModelError, match="1 node states for 2 segments"):
        machine.run(times, inputs, model.value_vector, START, starts=np.array([0, 2]))


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
print(kernel.library is not None, repr(float(run.outputs.sum() + run.output_sensitivities.sum())))
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
    """Three processes that need the same code at once all get it; a fourth finds the library."""
    processes = [begin(tmp_path) for _ in range(3)]
    results, said = zip(*(finish(process) for process in processes), strict=True)
    counts = [text.count("compiling the equations of 'roll'") for text in said]
    assert sum(counts) >= 1 == max(counts)
    again, quiet = finish(begin(tmp_path))
    assert "compiling" not in quiet
    assert set(results) == {again}
    assert again.startswith("True")
    assert len(list(tmp_path.glob("*.so"))) == 1
    assert not [p for p in tmp_path.iterdir() if p.is_dir()]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache, and a process that has not yet looked for a compiler nor said anything."""
    monkeypatch.setenv("OED_SYSID_CACHE", str(tmp_path))
    memories = (compiling._compiler, compiling._say_interpreted, compiling._machine_digest)
    for memory in memories:
        memory.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    for memory in memories:
        memory.cache_clear()


def rolled() -> tuple[bool, float]:
    """Whether compiled code ran, and the sum of all numbers that a new kernel returns."""
    model, times = roll_oscillator(), 0.1 * np.arange(50)
    machine, start = Kernel(model), np.array([0.3, 0.0])
    run = machine.run(times, 0 * times[:, None], model.value_vector, start, sensitivities=True)
    return machine.library is not None, float(run.outputs.sum() + run.output_sensitivities.sum())


def test_torn_library_is_rebuilt(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A damaged library is never loaded; it is built again. Other flags make another one."""
    good = rolled()
    (library,) = folder.glob("*.so")
    content = library.read_bytes()
    for damaged in (content[:5000], b"", None):
        if damaged is None:
            library.with_suffix(".sha256").unlink()
        else:
            library.unlink()  # what this process has loaded stays as it is
            library.write_bytes(damaged)
        assert rolled() == good
        assert library.read_bytes() == content
        assert library.with_suffix(".sha256").exists()
    monkeypatch.setattr(compiling, "_FLAGS", (*compiling._FLAGS, "-O1"))
    compiling._machine_digest.cache_clear()
    assert rolled() == pytest.approx(good, rel=1e-12)
    assert len(list(folder.glob("*.so"))) == 2


def test_without_a_compiler_the_interpreter_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a compiler the numbers are the same, and this is said once."""
    compiled = rolled()
    monkeypatch.setenv("OED_SYSID_COMPILER", "none")
    compiling._compiler.cache_clear()
    with pytest.warns(UserWarning, match="Models run in CasADi's interpreter") as said:
        results = [rolled() for _ in range(2)]
    assert compiled[0]
    assert len(said) == 1
    assert results == [(False, pytest.approx(compiled[1], rel=1e-12))] * 2


def test_cache_that_cannot_be_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the cache cannot be written the interpreter runs and says why."""
    (folder / "file").write_text("not a folder")
    monkeypatch.setenv("OED_SYSID_CACHE", str(folder / "file"))
    with pytest.warns(UserWarning, match="cannot be written"):
        assert not rolled()[0]


def test_changed_source_is_another_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Text and flags of a source enter its name: neither a stale nor a needless compilation."""
    monkeypatch.setenv("OED_SYSID_CACHE", str(tmp_path))

    def answer(text: str, *flags: str) -> int:
        library = compiling.load_source("answer", lambda: text, what="a number", flags=flags)
        return library.answer()

    assert answer("int answer(void) { return 1; }") == 1
    assert answer("int answer(void) { return 2; }") == 2
    assert answer("int answer(void) { return ANSWER; }", "-DANSWER=3") == 3
    assert answer("int answer(void) { return ANSWER; }", "-DANSWER=4") == 4
    built = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.so")}
    assert len(built) == 4
    assert answer("int answer(void) { return 1; }") == 1
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.so")} == built


def test_models_depend_on_their_own_source_only() -> None:
    """The name of a model's library depends on the C files it may include and on no other."""
    native = ROOT / "oed_sysid" / "compiled"
    included = set(re.findall(r'"(\w+\.c)"', (native / "compile.py").read_text()))
    included &= {path.name for path in native.glob("*.c")}
    counted = {Path(name).name for name in compiling._GENERATOR if name.endswith(".c")}
    assert counted == included == {"trajectory.c", "filter.c"}
