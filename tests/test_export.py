"""Models out: every language repeats the package's simulation, and uncertainty goes along."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from types import ModuleType

import casadi as ca
import numpy as np
import pytest
from motion import outputs, states
from test_stiff import DRIVE
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid import Fit, Function, Input, Model, MultipleShooting, Output, load_problem
from oed_sysid.cli import main
from oed_sysid.compiled.graph import build
from oed_sysid.errors import ModelError
from oed_sysid.experiments.simulation import equilibrium, linearise, simulate_inputs
from oed_sysid.export import KINDS, export, program_of
from oed_sysid.export.c_code import self_test
from oed_sysid.export.program import Example, example
from oed_sysid.physics import Parameter, actuator_lag, rate_limit, sensor_delay, sensor_lag

COMPILER = shutil.which("cc") or shutil.which("gcc")
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")

# Everything that the language has: tables, conditions, a function, lags, limits, sensors' memory.
CROOKED = Model(
    "crooked boat",
    states("u r psi", r=0.1),
    (Input("rudder", "rad"), Input("wind", "m/s", interpolation="linear")),
    (*outputs("u r psi"), Output("a", "m/s^2", "", "dot(u)")),
    {
        "u": "(1.5 - u)/T + 0.1*drag(u, r) "
        "- (0.2*u if wind > 0.03 and not r < 0 else 0.1*abs(u)*u)",
        "r": "(K*rudder*min(u, 2) - r)/T - 0.1*sign(r)*r**2 + 0.01*gust(wind, u) "
        "+ clip(wind, -0.05, 0.05)",
        "psi": "r",
    },
    parameters=(Parameter("K", 0.5, "1/m"), Parameter("T", 4.0, "s")),
    tables={
        "drag": (
            np.array([0.0, 1.0, 3.0]),
            np.array([-0.1, 0.0, 0.1]),
            np.array([[0.0, 0.1, 0.0], [-0.1, 0.0, -0.2], [-1.0, -0.8, -1.1]]),
        )
    },
    functions=(Function("gust", lambda w, u: ca.atan2(w, 1 + u**2) * ca.fmax(u, 0.1)),),
    step=0.1,
)
CROOKED = (
    CROOKED
    + rate_limit("engine", "rudder", value=0.4)
    + actuator_lag("servo", "rudder", value=0.7)
    + sensor_lag("gyro", "r", value=0.3)
    + sensor_delay("compass", "psi", max_delay=0.5, interval=0.25, value=0.25)
)
MODELS = {
    "crooked": CROOKED,
    "stiff": DRIVE + actuator_lag("lag", "command", value=0.05),
    "remus_6dof": load_problem("remus_6dof").model,
}


@pytest.fixture(scope="module")
def fit() -> Fit:
    """Yaw model with one parameter of its own for each record."""
    model = yaw_model(K=Parameter("K", 0.1, "1/s", per_record=True))
    return MultipleShooting(noise=NOISE, disturbances="none").fit(model, yaw_data(1))


def trajectory(model: Model) -> Example:
    """Lively inputs at uneven times."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.5, 3.0, 80)) * model.step
    inputs = 0.1 * np.repeat(rng.standard_normal((20, len(model.inputs))), 4, axis=0)
    if "T" in model.input_names:
        inputs[:, model.input_names.index("T")] = 8.0
    own = np.array([0.5 * state.scale for state in model.states])
    run = simulate_inputs(model, times, inputs=inputs, initial=own)
    return Example(times, inputs, own, model.value_vector, run.outputs)


def loaded(file: Path) -> ModuleType:
    """A Python file as a module."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def compiled(folder: Path, name: str) -> subprocess.CompletedProcess:
    """Compile a self-test as strictly as it goes, and run it."""
    assert COMPILER is not None
    built = subprocess.run(
        [COMPILER, "-O2", "-std=c99", "-Wall", "-Wextra", "-Werror", f"{name}.c", f"{name}_test.c",
         "-lm", "-o", "run"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert not built.returncode, built.stderr
    return subprocess.run([folder / "run"], capture_output=True, text=True, check=False)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference in units of each output's largest value."""
    return float(np.max(np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)))


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
@pytest.mark.parametrize("name", MODELS)
def test_c_repeats_the_package(tmp_path: Path, name: str) -> None:
    """The self-test of the C code passes at 1e-9 on a lively trajectory, and can fail."""
    program, run = program_of(MODELS[name]), trajectory(MODELS[name])
    export(MODELS[name], "c", tmp_path)
    code = tmp_path / f"{program.identifier}_test.c"
    code.write_text(self_test(program, run))
    done = compiled(tmp_path, program.identifier)
    assert done.returncode == 0, done.stdout
    assert float(done.stdout.split()[-1]) < 1e-9
    wrong = Example(run.times, run.inputs, run.own, run.parameters * (1 + 1e-7), run.outputs)
    code.write_text(self_test(program, wrong))
    assert compiled(tmp_path, program.identifier).returncode == 1


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
def test_c_of_a_fit_repeats_its_first_record(tmp_path: Path, fit: Fit) -> None:
    """What export writes tests itself on the fit's own record, with that record's parameters."""
    export(fit, "c", tmp_path)
    done = compiled(tmp_path, "yaw")
    assert done.returncode == 0, done.stdout
    assert int(done.stdout.split()[0]) == fit.dataset[0].n_samples
    run = example(program_of(fit))
    index = fit.model.parameter_names.index("K")
    assert run.parameters[index] == fit.local_values[0]["K"]
    np.testing.assert_allclose(run.outputs, fit.predictions[0], atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_python_repeats_the_package(tmp_path: Path, name: str) -> None:
    """The NumPy module gives the same outputs, for one set of parameters and for many."""
    model, run = MODELS[name], trajectory(MODELS[name])
    (file,) = export(model, "python", tmp_path)
    module = loaded(file)
    start = dict(zip(module.OWN_STATES, run.own, strict=True))
    assert relative(module.simulate(run.times, run.inputs, start), run.outputs) < 1e-9
    spread = 1 + 0.01 * np.random.default_rng(0).standard_normal((len(run.parameters), 3))
    many = module.simulate(run.times, run.inputs, start, run.parameters[:, None] * spread)
    for k in range(3):
        values = dict(zip(model.parameter_names, run.parameters * spread[:, k], strict=True))
        alone = module.simulate(run.times, run.inputs, start, values)
        np.testing.assert_allclose(many[:, :, k], alone, rtol=1e-9, atol=1e-12)


def test_uncertainty_goes_along(tmp_path: Path, fit: Fit) -> None:
    """Drawn parameters have the covariance of the fit; model.json holds it too."""
    module = loaded(export(fit, "python", tmp_path)[0])
    assert tuple(n for n in fit.names if n != "K") == module.ESTIMATED
    rows = [fit.names.index(name) for name in module.ESTIMATED]
    np.testing.assert_array_equal(module.COVARIANCE, fit.covariance[np.ix_(rows, rows)])
    drawn = module.sample_parameters(20000, np.random.default_rng(1))
    index = list(module.PARAMETERS).index("T")
    assert np.std(drawn[index]) == pytest.approx(fit.std_errors["T"], rel=0.03)
    export(fit, "casadi", tmp_path / "casadi")
    stated = json.loads((tmp_path / "casadi" / "model.json").read_text())
    assert stated["covariance"] == module.COVARIANCE.tolist()


@pytest.mark.skipif(OCTAVE is None, reason="needs Octave")
@pytest.mark.parametrize("name", ["crooked", "remus_6dof"])
def test_matlab_repeats_the_package(tmp_path: Path, name: str) -> None:
    """The function file runs in Octave and gives the same outputs."""
    run = trajectory(MODELS[name])
    (file,) = export(MODELS[name], "matlab", tmp_path)
    for letter, values in (("t", run.times), ("u", run.inputs), ("o", run.own)):
        np.savetxt(tmp_path / f"{letter}.txt", values, fmt="%.17g")
    script = (
        f"y = {file.stem}('simulate', load('t.txt'), load('u.txt'), load('o.txt'));"
        "dlmwrite('y.txt', y, 'delimiter', ' ', 'precision', '%.17g');"
    )
    assert OCTAVE is not None
    subprocess.run(
        [OCTAVE, "-qf", "--eval", script], cwd=tmp_path, capture_output=True, check=False
    )
    found = np.loadtxt(tmp_path / "y.txt").reshape(run.outputs.shape)
    assert relative(found, run.outputs) < 1e-9


def test_stiff_models_are_not_written_for_matlab(tmp_path: Path) -> None:
    """A stiff model is refused with what to take instead."""
    with pytest.raises(ModelError, match="c, python or fmu"):
        export(DRIVE, "matlab", tmp_path)


def test_casadi_functions_load_and_step(tmp_path: Path) -> None:
    """Saved functions, loaded again, advance and measure as the package does."""
    model, run = CROOKED, trajectory(CROOKED)
    export(model, "casadi", tmp_path)
    start, advance, sample = (
        ca.Function.load(str(tmp_path / f"{name}.casadi"))
        for name in ("start", "advance", "sample")
    )
    z = start(run.own, run.inputs[0], run.parameters, run.times[0])
    before = 1.0  # length of the last step; at the start, no memory depends on it
    for k, t in enumerate(run.times[:30]):
        y, z = sample(z, run.inputs[k], run.parameters, t, before)
        np.testing.assert_allclose(y.full().ravel(), run.outputs[k], rtol=1e-9, atol=1e-12)
        interval = run.times[k + 1] - t
        n = int(np.ceil(interval / model.step - 1e-9))
        slope = np.array([0.0, 1.0]) * (run.inputs[k + 1] - run.inputs[k]) / n
        before = interval / n
        for i in range(n):
            begin, now = run.inputs[k] + i * slope, t + i * before
            if i > 0:
                _, z = sample(z, begin, run.parameters, now, before)
            z = advance(z, begin, begin + slope, run.parameters, now, before)


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
def test_fmu_repeats_the_package(tmp_path: Path) -> None:
    """FMPy finds nothing to object to, and steps of the unit equal the package's samples."""
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave
    from fmpy.validation import validate_fmu

    model = load_problem("remus_6dof").model
    model = model + sensor_lag("gyro", "r", value=0.3)
    (file,) = export(model, "fmu", tmp_path / "remus.fmu")
    assert validate_fmu(str(file)) == []
    assert "resources/model.json" in zipfile.ZipFile(file).namelist()
    run = trajectory(model)
    described = fmpy.read_model_description(str(file))
    numbers = {one.name: one.valueReference for one in described.modelVariables}
    outputs = [one.valueReference for one in described.modelVariables if one.causality == "output"]
    unit = FMU2Slave(
        guid=described.guid,
        unzipDirectory=fmpy.extract(str(file), tmp_path / "unit"),
        modelIdentifier=described.coSimulation.modelIdentifier,
        instanceName="remus",
    )
    unit.instantiate()
    unit.setupExperiment(startTime=float(run.times[0]))
    unit.enterInitializationMode()
    commands = [numbers[name] for name in model.input_names]
    unit.setReal([numbers[f"{s.name}_start"] for s in model.states], list(map(float, run.own)))
    unit.setReal(commands, list(map(float, run.inputs[0])))
    unit.exitInitializationMode()
    found = []
    for k, t in enumerate(run.times):
        unit.setReal(commands, list(map(float, run.inputs[k])))
        found.append(unit.getReal(outputs))
        if k == 40:  # a state that was kept can be returned to
            kept = unit.getFMUState()
            unit.doStep(float(t), 1.0)
            unit.setFMUState(kept)
            unit.freeFMUState(kept)
        if k + 1 < len(run.times):
            unit.doStep(float(t), float(run.times[k + 1] - t))
    unit.terminate()
    unit.freeInstance()
    # The first measurement has no interval before it; sensors with memory start there.
    assert relative(np.array(found), run.outputs) < 1e-9


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
@pytest.mark.parametrize("kind", ["fmu", "fmu3"])
@pytest.mark.parametrize(("role", "error"), [("CoSimulation", 1e-11), ("ModelExchange", 1e-4)])
def test_both_interfaces_in_both_roles(tmp_path: Path, kind: str, role: str, error: float) -> None:
    """With tuned parameters the unit steps as the package, and an importer's own integrator."""
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    model = yaw_model()
    (file,) = export(model, kind, tmp_path)
    assert validate_fmu(str(file)) == []
    result = fmpy.simulate_fmu(
        str(file), fmi_type=role, stop_time=50.0, step_size=0.5, output_interval=0.5,
        relative_tolerance=1e-9, start_values={"delta": 0.2, "K": 0.3, "r_start": 0.01},
    )  # fmt: skip
    run = simulate_inputs(
        model.with_values({"K": 0.3}),
        np.arange(101) * 0.5,
        inputs={"delta": 0.2},
        initial={"r": 0.01},
    )
    assert relative(result["psi_measured"], run.output("psi")) < error


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
@pytest.mark.parametrize("kind", ["fmu", "fmu3"])
def test_a_unit_with_sampled_memory_steps_by_itself(tmp_path: Path, kind: str) -> None:
    """Memory of a sensor that is sampled is no continuous state: co-simulation only."""
    fmpy = pytest.importorskip("fmpy")
    (file,) = export(yaw_model() + sensor_lag("gyro", "psi", value=0.3), kind, tmp_path)
    described = fmpy.read_model_description(str(file))
    assert described.modelExchange is None
    assert described.coSimulation is not None


@pytest.mark.slow
def test_a_crossing_compiler_adds_the_other_platforms(tmp_path: Path) -> None:
    """Each library is of the format of its platform."""
    pytest.importorskip("ziglang")
    (file,) = export(yaw_model(), "fmu3", tmp_path)
    begin = {"windows": b"MZ", "linux": b"\x7fELF", "darwin": b"\xcf\xfa\xed\xfe"}
    with zipfile.ZipFile(file) as unit:
        names = [name for name in unit.namelist() if name.startswith("binaries/")]
        assert len(names) == 5
        for name in names:
            system = name.split("/")[1].split("-")[1]
            assert unit.read(name).startswith(begin[system]), name


def test_control_model_is_the_linear_model(tmp_path: Path, fit: Fit) -> None:
    """Matrices equal those of linearise; errors of the entries are those of the calculus."""
    (file,) = export(fit, "control", tmp_path / "linear.py", trim={"delta": 0.05})
    module = loaded(file)
    point = equilibrium(fit.model, inputs={"delta": 0.05})
    expected = linearise(fit.model, point)
    np.testing.assert_allclose(module.system.A, expected.A, atol=1e-12)
    np.testing.assert_allclose(module.system.B, expected.B, atol=1e-12)
    # A_rr = -(1 + 3 alpha r^2)/T with alpha r^3 + r = K delta.
    values = {"K": fit.model.values["K"]} | fit.values
    r, T, alpha = point.states["r"], values["T"], values["alpha"]
    by_alpha = -(3 * r**2 + 6 * alpha * r * (-(r**3) / (1 + 3 * alpha * r**2))) / T
    slope = np.array(
        [{"T": (1 + 3 * alpha * r**2) / T**2, "alpha": by_alpha}[n] for n in module.ESTIMATED]
    )
    std = np.sqrt(slope @ module.COVARIANCE @ slope)
    row = module.system.state_labels.index("r")
    assert module.A_STD[row, row] == pytest.approx(std, rel=1e-4)


def test_control_without_a_trim_says_what_to_give(tmp_path: Path) -> None:
    """A model that never rests is answered with how to state a trim."""
    falling = Model(
        "falling", states("w"), (Input("T", "N"),), outputs("w"), {"w": "9.81 + w**2 + T"}
    )
    with pytest.raises(ModelError, match="Inputs that are not given are zero"):
        export(falling, "control", tmp_path)


@pytest.mark.parametrize("name", ["crooked", "remus_6dof"])
def test_sympy_rates_are_those_of_the_model(tmp_path: Path, name: str) -> None:
    """Expressions with numbers put in equal the model's rates at any point."""
    sympy = pytest.importorskip("sympy")
    model = MODELS[name]
    module_file, page = export(model, "sympy", tmp_path)
    module, graph = loaded(module_file), build(model)
    arguments = [*module.STATES, *module.SIGNALS, *module.PARAMETERS, module.t]
    rates = sympy.lambdify(arguments, module.RATES, "numpy", cse=True)
    rng = np.random.default_rng(5)
    for _ in range(5):
        x = 0.3 * rng.standard_normal(len(module.STATES)) + 0.5
        d = 0.1 * rng.standard_normal(len(module.SIGNALS))
        expected = graph.rates(x, d, model.value_vector, 0.0).full().ravel()
        np.testing.assert_allclose(
            rates(*x, *d, *model.value_vector, 0.0), expected, rtol=1e-9, atol=1e-12
        )
    text = page.read_text()
    assert text.count(r"\begin{align*}") == text.count(r"\end{align*}") == 2
    assert text.count("{") == text.count("}")


def test_latex_has_the_numbers(tmp_path: Path, fit: Fit) -> None:
    """Values with intervals stand in the table, and in place of letters in the equations."""
    _, page = export(fit, "sympy", tmp_path)
    text = page.read_text()
    low, high = fit.interval("T")
    assert f"${low:.4g}$ to ${high:.4g}$" in text
    numbers = text.split("With numbers")[1].split(r"\end{align*}")[0]
    assert f"{fit.values['T']:.4g}" in numbers
    assert r"\alpha" not in numbers


def test_saved_fits_are_exported_by_the_command(tmp_path: Path, fit: Fit, capsys) -> None:
    """oed-sysid export reads what --save wrote; an unknown kind is refused in words."""
    saved = tmp_path / "fit.json"
    fit.save(saved)
    for kind in ("c", "python", "casadi", "fmu", "matlab", "control", "sympy"):
        assert main(["export", str(saved), "--as", kind, "--out", str(tmp_path / kind)]) == 0
        lines = capsys.readouterr().out.splitlines()
        # The first line says what was written, then where.
        for line in lines:
            assert Path(line.rpartition(": ")[2]).stat().st_size > 100
    assert main(["export", str(saved), "--as", "fortran"]) == 2
    assert "It has fmu3, fmu, c" in capsys.readouterr().err
    assert main(["export", str(saved)]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert listed == [*KINDS]
    assert main(["export", str(saved), "--as", "control", "--at", "delta"]) == 2
    assert "NAME=VALUE" in capsys.readouterr().err
