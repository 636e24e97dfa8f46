"""Whole models that CasADi functions bring."""

from __future__ import annotations

import contextlib
import os
import pickle
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import Dataset, Experiment, Fit, Model, Piecewise, improve, rank_parameters, simulate
from oed_sysid.cli import DONE
from oed_sysid.compiled.graph import build
from oed_sysid.errors import ModelError
from oed_sysid.export import export
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.start_guess import measured_columns
from oed_sysid.physics import Force, Parameter
from oed_sysid.physics.channels import Input, Output, State

STATES = (State("psi", "rad"), State("r", "rad/s"))
INPUTS = (Input("delta", "rad"),)
PARAMETERS = (Parameter("K", 0.2, "1/s"), Parameter("T", 15.0, "s"), Parameter("a", 5.0, "s^2"))
OUTPUTS = (Output("heading", "rad", noise_std=0.002), Output("rate", "rad/s", noise_std=0.0005))
GRID = np.linspace(-0.6, 0.6, 13)
LIFT = np.sin(2 * GRID) / 2


def columns() -> tuple[ca.MX, ca.MX, ca.MX]:
    """State, input and parameters as columns."""
    return ca.MX.sym("x", 2), ca.MX.sym("u"), ca.MX.sym("p", 3)


def norrbin(lift: ca.Function | None = None) -> Model:
    """A ship's yaw with a cubic term; its rudder's lift by a table where one is given."""
    x, u, p = columns()
    angle = u if lift is None else lift(u)
    rate = (p[0] * angle - x[1] - p[2] * x[1] ** 3) / p[1]
    f = ca.Function("f", [x, u, p], [ca.vertcat(x[1], rate)], ["x", "u", "p"], ["rate"])
    h = ca.Function("h", [x], [ca.vertcat(x[0], 2 * x[1] / 2)], ["x"], ["y"])
    return Model.from_casadi(
        f, h, states=STATES, inputs=INPUTS, parameters=PARAMETERS, outputs=OUTPUTS, step=0.5
    )


def written() -> Model:
    """The same ship as text."""
    rate = "(K*delta - r - a*r*r*r)/T"
    outputs = tuple(
        Output(o.name, o.unit, noise_std=o.noise_std, expression=s.name)
        for o, s in zip(OUTPUTS, STATES, strict=True)
    )
    return Model(
        "text", STATES, INPUTS, outputs, {"psi": "r", "r": rate}, parameters=PARAMETERS, step=0.5
    )


def experiment() -> Experiment:
    """A few orders of rudder."""
    orders = Piecewise("delta", [0.0, 5.0, 60.0, 120.0, 180.0], [0.0, 0.3, -0.3, 0.15, 0.0])
    return Experiment("orders", orders, duration=240.0, sample_time=1.0)


def linear_lift() -> ca.Function:
    """Linear interpolant of CasADi, which has no elementary operations."""
    return ca.interpolant("lift", "linear", [GRID.tolist()], LIFT.tolist())


def test_a_casadi_model_is_the_text_model() -> None:
    """Elementary operations give the same trajectories and the same fit; states are seen."""
    assert measured_columns(norrbin()) == {0: 0, 1: 1}
    assert norrbin().kinematics["psi"] == "r"
    record = simulate(written(), experiment(), rng=np.random.default_rng(1))
    estimator = MultipleShooting(disturbances="none")
    fits = [estimator.fit(model, Dataset((record,))) for model in (written(), norrbin())]
    for name in ("K", "T", "a"):
        assert fits[1].values[name] == pytest.approx(fits[0].values[name], rel=1e-7)
        assert fits[1].std_errors[name] == pytest.approx(fits[0].std_errors[name], rel=1e-6)


@pytest.mark.parametrize("kind", ["linear", "bspline"])
def test_an_interpolant_inside_is_called(kind: str) -> None:
    """A model with CasADi's interpolant runs as SciPy integrates it."""
    lift = ca.interpolant("lift", kind, [GRID.tolist()], LIFT.tolist())
    model = norrbin(lift)
    run = simulate(model, experiment(), noise=False)

    def rates(t: float, x: np.ndarray) -> list[float]:
        order = float(np.interp(t, run.times, run.inputs[:, 0]))
        k = np.searchsorted(run.times, t, side="right") - 1
        order = float(run.inputs[k, 0])
        values = model.values
        turn = values["K"] * float(lift(order)) - x[1] - values["a"] * x[1] ** 3
        return [x[1], turn / values["T"]]

    state = np.array([0.0, 0.0])
    for k in range(len(run.times) - 1):
        span = (run.times[k], run.times[k + 1])
        state = solve_ivp(rates, span, state, rtol=1e-9, atol=1e-12, max_step=0.5).y[:, -1]
    assert run.outputs[-1] == pytest.approx(state, rel=1e-5, abs=1e-9)


def test_everything_works_with_an_interpolant(tmp_path: Path) -> None:
    """It is fitted, ranked, extended, saved, read back and sent to another process."""
    model = norrbin(linear_lift())
    truth = model + Force("bias", {"r": "b"}, (Parameter("b", 2e-4, "rad/s^2"),))
    record = simulate(truth, experiment(), rng=np.random.default_rng(2))
    candidate = Force("bias", {"r": "b"}, (Parameter("b", 0.0, "rad/s^2", scale=1e-4),))
    fit = MultipleShooting(disturbances="none").fit(model, Dataset((record,)))
    better = improve(model, Dataset((record,)), candidates=[candidate]).fit
    assert "bias" in better.model.effect_names
    assert fit.status.ok
    assert abs(better.values["b"] - 2e-4) < 4 * better.std_errors["b"]
    assert set(rank_parameters(model, experiment()).by_information) == {"K", "T", "a"}
    better.save(tmp_path / "fit.json")
    assert Fit.load(tmp_path / "fit.json").values == better.values
    assert pickle.loads(pickle.dumps(model)) == model


def test_a_saved_fit_does_not_bring_code(tmp_path: Path) -> None:
    """Where the functions are unknown, a saved fit says what to do."""
    record = simulate(written(), experiment(), rng=np.random.default_rng(3))
    path = tmp_path / "fit.json"
    MultipleShooting(disturbances="none").fit(norrbin(linear_lift()), Dataset((record,))).save(path)
    code = f"import oed_sysid; oed_sysid.Fit.load({str(path)!r})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode != 0
    assert "from_casadi" in run.stderr.splitlines()[-1]
    assert "--problem FOLDER" in run.stderr.splitlines()[-1]


def test_a_folder_brings_the_functions_of_its_saved_fit(tmp_path: Path) -> None:
    """In a new process `export` reads a fit beside the problem that it is of."""
    (tmp_path / "ship").mkdir()
    (tmp_path / "ship" / "problem.py").write_text(
        "from test_from_casadi import linear_lift, norrbin\nfrom oed_sysid import Problem\n"
        "problem = Problem('ship', norrbin(linear_lift()), title='Ship')\n"
    )
    record = simulate(written(), experiment(), rng=np.random.default_rng(3))
    fit = MultipleShooting(disturbances="none").fit(norrbin(linear_lift()), Dataset((record,)))
    fit.save(tmp_path / "fit.json")
    line = [sys.executable, "-m", "oed_sysid", "export", "fit.json", "--as", "casadi", "--out", "o"]
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*line, "--problem", "ship"], cwd=tmp_path, env=os.environ | {"PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == DONE, done.stderr
    rates = ca.Function.load(str(tmp_path / "o" / "rates.casadi"))
    assert float(rates([0.1, 0.02], [0.2], fit.model.value_vector, 0.0)[0]) == pytest.approx(0.02)


class Tanh(ca.Callback):
    """A function that Python evaluates."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.construct("tanh", {"enable_fd": True})

    def eval(self, given: list[ca.DM]) -> list[float]:
        """Its value."""
        return [np.tanh(float(given[0]))]


def test_what_is_no_function_of_casadi_is_refused() -> None:
    """A callback lives with its Python object, and a function of Python is none of CasADi."""
    with pytest.raises(ModelError, match=r"'tanh', which cannot be copied.*no callbacks"):
        norrbin(Tanh())
    with pytest.raises(ModelError, match=r"no function of CasADi. Write casadi\.Function"):
        Model.from_casadi(lambda x, u, p: -p * x, states=STATES)  # type: ignore[arg-type]


def test_without_c_the_interpreter_runs_it() -> None:
    """A rootfinder, for which CasADi writes no C, gives the solution of its equation."""
    y, load = ca.MX.sym("y"), ca.MX.sym("load")
    root = ca.rootfinder("root", "newton", {"x": y, "p": load, "g": y**3 + y - load})
    x, u, p = columns()
    f = ca.Function("f", [x, u, p], [ca.vertcat(x[1], (p[0] * root(0.0, u) - x[1]) / p[1])])
    model = Model.from_casadi(f, states=STATES, inputs=INPUTS, parameters=PARAMETERS, step=0.5)
    held = Experiment("held", None, duration=300.0, sample_time=1.0, constants={"delta": 0.3})
    with pytest.warns(UserWarning, match="not supported for Newton"):
        run = simulate(model, held, noise=False)
    turn = run.outputs[-1, 1] / model.values["K"]
    assert turn**3 + turn == pytest.approx(0.3, rel=1e-6)


def test_exports_say_what_they_cannot_hold(tmp_path: Path) -> None:
    """What needs elementary operations names the function; CasADi and a linear model do without."""
    model = norrbin(linear_lift())
    with pytest.raises(ModelError, match=r"lift.*casadi, control or latex"):
        export(model, "c", tmp_path)
    files = {file.name: file for file in export(model, "casadi", tmp_path)}
    rates = ca.Function.load(str(files["rates.casadi"]))
    point = [0.1, 0.02], [0.2], model.value_vector, 0.0
    found = np.array(rates(*point)).ravel()
    assert found == pytest.approx(np.array(build(model).rates(*point)).ravel(), rel=1e-12)
    assert found[0] == pytest.approx(0.02)
    (linear,) = export(model, "control", tmp_path)
    assert runpy.run_path(str(linear))["A"][0][1] == pytest.approx(1.0)
    (page,) = export(model, "latex", tmp_path)
    assert page.stat().st_size > 0


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"states": STATES[:1]}, "returns 2 numbers|shapes"),
        ({"parameters": PARAMETERS[:2]}, "shapes"),
        ({"outputs": OUTPUTS[:1]}, "returns 2 numbers"),
    ],
)
def test_sizes_are_checked(change: dict, match: str) -> None:
    """Sizes that do not agree are named."""
    x, u, p = columns()
    f = ca.Function("f", [x, u, p], [ca.vertcat(x[1], p[0] * u - x[1])])
    h = ca.Function("h", [x], [x])
    given = {"states": STATES, "inputs": INPUTS, "parameters": PARAMETERS, "outputs": OUTPUTS}
    with pytest.raises(ModelError, match=match):
        Model.from_casadi(f, h, **(given | change))


def test_an_external_function_needs_derivatives(tmp_path: Path) -> None:
    """Compiled code without derivatives is refused by name; with finite differences it runs."""
    delta = ca.SX.sym("delta")
    with contextlib.chdir(tmp_path):
        ca.Function("lift", [delta], [delta * (1 - 0.3 * delta**2)]).generate("lift.c")
    library = tmp_path / "lift.so"
    command = ["cc", "-shared", "-fPIC", str(tmp_path / "lift.c"), "-o", str(library)]
    if shutil.which("cc") is None or subprocess.run(command, check=False).returncode:
        pytest.skip("no compiler")
    x, u, p = columns()
    for options, refused in (({}, True), ({"enable_fd": True}, False)):
        lift = ca.external("lift", str(library), options)
        f = ca.Function("f", [x, u, p], [ca.vertcat(x[1], (p[0] * lift(u) - x[1]) / p[1])])
        parts = {"states": STATES, "inputs": INPUTS, "parameters": PARAMETERS}
        if refused:
            with pytest.raises(ModelError, match=r"no derivatives of 'f'.*enable_fd"):
                Model.from_casadi(f, **parts)
            continue
        model = Model.from_casadi(f, **parts, step=0.5)
        held = Experiment("held", None, duration=300.0, sample_time=1.0, constants={"delta": 0.3})
        with pytest.warns(UserWarning, match="interpreter"):
            turn = simulate(model, held, noise=False).outputs[-1, 1]
        assert turn == pytest.approx(model.values["K"] * 0.3 * (1 - 0.3 * 0.3**2), rel=1e-6)
