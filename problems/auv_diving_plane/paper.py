"""The headline of Xu, Zou, Yin and Cao (2012): 18 coefficients from one zigzag by LS-SVM.

Prints the error of every coefficient for each way to take accelerations (and for a one-step
regression, which needs none), the sensitivity that explains some of them, what extra excitation
changes, what the weight C means, and what multiple shooting makes of the same record.
``--figures FOLDER`` draws fin and pitch, the sensitivities, and the reduced against the full model.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from oed_sysid import Dataset, Experiment, MultipleShooting, Record, load_problem, rank_parameters
from oed_sysid.baselines import LeastSquaresSVM, SupportVectorRegression
from oed_sysid.baselines.equations import exact_rates
from oed_sysid.compiled.kernels import kernel
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.manoeuvres import Piecewise, ZigZagLike
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.results import new_figure

problem = load_problem("auv_diving_plane")
TRUTH = problem.truth
BEYOND = 5.0  # per cent, the published mark
STATES = ("u", "w", "q", "theta", "x", "z")
AREA = 0.5 * 1025 * 5.3**2  # rho/2 L^2, which makes forces dimensionless; times L, moments
DIMENSIONLESS = {"u": AREA, "w": AREA, "q": AREA * 5.3}


def published_run() -> Record:
    """The 5/5 zigzag of the paper."""
    return simulate(problem.model, problem.experiment("zigzag_5_5"), noise=False)


def excitations() -> dict[str, Record]:
    """The published run, and runs that move the fin more, or in more ways."""
    rng = np.random.default_rng(0)
    runs = {"zigzag 5/5": published_run()}
    large = np.radians(20.0)
    limits = Limits(inputs={"delta_s": (-large, large)}, rates={"delta_s": np.radians(10.0)})
    steps = np.cumsum(rng.uniform(2.0, 8.0, 60))
    for label, angle in (("random steps 5", 5.0), ("random steps 20", 20.0)):
        levels = np.radians(angle) * rng.uniform(-1.0, 1.0, len(steps))
        command = Piecewise("delta_s", steps, levels, interpolation="linear")
        runs[label] = _run(label, command, limits)
    angle = np.radians(15.0)
    command = ZigZagLike("delta_s", angle, angle, rate=np.radians(10.0))
    runs["zigzag 15/15"] = _run("zigzag 15/15", command, limits)
    return runs


def _run(name: str, command: Piecewise | ZigZagLike, limits: Limits) -> Record:
    like = problem.experiment("zigzag_5_5")
    experiment = Experiment(
        name.replace(" ", "_").replace("/", "_"),
        command,
        duration=like.duration,
        sample_time=like.sample_time,
        initial=like.initial,
        feedback="true",
        limits=limits,
    )
    return simulate(problem.model, experiment, noise=False)


def one_step(record: Record, *, rounds: int = 8) -> dict[str, float]:
    r"""Fit one sample ahead from each measured one; no accelerations.

    Gauss-Newton on :math:`x_{k+1} - \phi(x_k, \delta; \theta)`, every state by its spread, from
    the values of Simpson's rule.
    """
    start = LeastSquaresSVM(rule="simpson").fit(problem.model, Dataset((record,)))
    model = problem.model.with_values(start.values)
    runner, names = kernel(model), model.free_names
    sizes = np.array([abs(TRUTH[name]) for name in names])
    spread = np.diff(record.outputs, axis=0).std(axis=0)
    for _ in range(rounds):
        values = model.value_vector
        errors, slopes = [], []
        for k in range(record.n_samples - 1):
            pair = slice(k, k + 2)
            z, _ = runner.start(record.outputs[k], record.inputs[k], values, record.times[k])
            run = runner.run(record.times[pair], record.inputs[pair], values, z, sensitivities=True)
            errors.append((record.outputs[k + 1] - run.outputs[1]) / spread)
            slopes.append(run.output_sensitivities[1][:, runner.n_full :] * sizes / spread[:, None])
        change = np.linalg.lstsq(np.vstack(slopes), np.hstack(errors), rcond=None)[0]
        now = {
            n: model.values[n] + size * c for n, size, c in zip(names, sizes, change, strict=True)
        }
        model = model.with_values(now)
    return {name: model.values[name] for name in names}


def ways(record: Record) -> dict[str, dict[str, float]]:
    """Values of all free numbers for every way to take accelerations."""
    data = Dataset((record,))
    exact = exact_rates(problem.model, data)
    own = [record.channels.output_names.index(name) for name in STATES]
    states = record.outputs[:, own]
    difference = {
        "central": np.gradient(states, record.times, axis=0),
        "five points": _five_points(states, record.sample_time),
    }
    found = {"exact": LeastSquaresSVM(rule="exact", rates=exact)}
    found |= {rule: LeastSquaresSVM(rule=rule) for rule in ("simpson", "trapezoid", "euler")}
    found["local"] = LeastSquaresSVM(rule="local")
    for rule, rates in difference.items():
        found[rule] = LeastSquaresSVM(rule="exact", rates={record.name: rates})
    found["e-SVR"] = SupportVectorRegression(rule="simpson")
    values = {label: method.fit(problem.model, data).values for label, method in found.items()}
    values["one step"] = one_step(record)
    values["shooting"] = shooting(record).values
    return values


def shooting(record: Record, factor: float = 1.3) -> Fit:
    """Trajectories fitted from start values that are the truth's times ``factor``."""
    away = problem.model.with_values({name: factor * value for name, value in TRUTH.items()})
    return MultipleShooting(disturbances="none").fit(away, Dataset((record,)))


def _five_points(states: np.ndarray, step: float) -> np.ndarray:
    """Central differences of fourth order inside, of second at the ends; ``(n, n_states)``."""
    rates = np.gradient(states, step, axis=0)
    inner = 8.0 * (states[3:-1] - states[1:-3]) - (states[4:] - states[:-4])
    rates[2:-2] = inner / (12.0 * step)
    return rates


def errors(values: dict[str, float]) -> dict[str, float]:
    """Errors of all free numbers, per cent."""
    return {name: 100 * (values[name] / truth - 1) for name, truth in TRUTH.items()}


def beyond(values: dict[str, float]) -> tuple[str, ...]:
    """Names of the coefficients that err by more than 5 %."""
    return tuple(name for name, error in errors(values).items() if abs(error) > BEYOND)


def sensitivities(record: Record) -> dict[str, float]:
    """Relative change of u, w, q, theta, summed, for 20 % more of each coefficient."""
    reference = record.outputs[:, :4]
    found = {}
    for name, value in TRUTH.items():
        changed = problem.model.with_values({name: 1.2 * value})
        run = simulate_inputs(changed, record.times, inputs=record.inputs, initial={"z": 100.0})
        change = np.abs(run.outputs[:, :4] - reference)
        found[name] = float((change.sum(axis=0) / np.abs(reference).sum(axis=0)).sum())
    return dict(sorted(found.items(), key=lambda pair: pair[1]))


def least_sensitive(names: tuple[str, ...], order: dict[str, float]) -> bool:
    """Whether these are exactly the least sensitive coefficients of heave and pitch."""
    heave_pitch = [name for name in order if name[0] in "ZMz"]
    return bool(names) and set(names) == set(heave_pitch[: len(names)])


def reduced_errors(record: Record) -> dict[str, float]:
    """Error of the reduced model's u, w, q, theta, rms over the rms of each."""
    model = problem.variant("reduced").model
    run = simulate_inputs(model, record.times, inputs=record.inputs, initial={"z": 100.0})
    reference = record.outputs[:, :4]
    size = np.sqrt(np.mean(reference**2, axis=0))
    error = np.sqrt(np.mean((run.outputs[:, :4] - reference) ** 2, axis=0))
    return dict(zip(STATES, (error / size).tolist(), strict=False))


def weighted(record: Record, weight: float) -> dict[str, float]:
    """Errors, per cent, with exact accelerations and this C in dimensionless equations."""
    data = Dataset((record,))
    rates = exact_rates(problem.model, data)
    method = LeastSquaresSVM(C=weight, rule="exact", rates=rates, scale=DIMENSIONLESS)
    return errors(method.fit(problem.model, data).values)


def forms(record: Record, scale: str | dict[str, float]) -> tuple[Fit, Fit]:
    """Primal and dual solution of the same equations, divided by ``scale``."""
    primal, dual = (
        LeastSquaresSVM(form=form, rule="trapezoid", scale=scale).fit(
            problem.model, Dataset((record,))
        )
        for form in ("primal", "dual")
    )
    return primal, dual


def apart(primal: Fit, dual: Fit) -> float:
    """Largest relative difference of two solutions."""
    return float(np.max(np.abs(dual.estimates / primal.estimates - 1)))


def figures(folder: Path, record: Record, order: dict[str, float]) -> None:
    """Fin and pitch; sensitivities; the reduced against the full model."""
    figure, grid = new_figure(1, 1, size=(7, 3.5))
    axes = grid[0, 0]
    fin, pitch = np.degrees(record.input("delta_s")), np.degrees(record.output("theta"))
    axes.plot(record.times, fin, color="gray", linestyle="--", label="stern plane delta_s")
    axes.plot(record.times, pitch, color="black", label="pitch theta")
    axes.set(xlabel="time [s]", ylabel="angle [deg]")
    axes.legend()
    figure.savefig(folder / "auv_fin_and_pitch.png", dpi=120)

    figure, grid = new_figure(1, 1, size=(7, 5))
    axes = grid[0, 0]
    axes.barh([name.removesuffix("_prime") for name in order], list(order.values()), color="C0")
    axes.set_xscale("log")
    axes.set_xlabel("relative change of u, w, q, theta for 20 % of each, summed")
    figure.savefig(folder / "auv_sensitivities.png", dpi=120)

    reduced = problem.variant("reduced").model
    run = simulate_inputs(reduced, record.times, inputs=record.inputs, initial={"z": 100.0})
    figure, grid = new_figure(4, 1, size=(7, 6), sharex=True)
    labels = ("u [m/s]", "w [m/s]", "q [deg/s]", "theta [deg]")
    for k, (axes, label) in enumerate(zip(grid[:, 0], labels, strict=True)):
        factor = np.degrees(1.0) if "deg" in label else 1.0
        axes.plot(record.times, factor * record.outputs[:, k], color="black", label="full")
        axes.plot(record.times, factor * run.outputs[:, k], "--", color="C1", label="reduced")
        axes.set_ylabel(label)
    axes.set_xlabel("time [s]")
    axes.legend(ncols=2)
    figure.savefig(folder / "auv_reduced_and_full.png", dpi=120)


def main(arguments: list[str] | None = None) -> None:
    """Print the headline."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    folder = parser.parse_args(arguments).figures
    record = published_run()
    columns, order = ways(record), sensitivities(record)
    print(f"errors in per cent{'':4}" + "".join(f"{label:>11}" for label in columns))
    for name in TRUTH:
        row = (errors(values)[name] for values in columns.values())
        print(f"{name.removesuffix('_prime'):22}" + "".join(f"{error:11.2f}" for error in row))
    print()
    print("beyond 5 % (published: 2 of 18; how accelerations were taken is not said)")
    for label, values in columns.items():
        wrong = beyond(values)
        least = "the least sensitive of Z and M" if least_sensitive(wrong, order) else ""
        print(f"  {label:11}{len(wrong):3d}  {least}")
    print()
    print(rank_parameters(problem.model, [problem.experiment("zigzag_5_5")]).report())
    print()
    runs = excitations()
    print(f"{'beyond 5 %, by excitation':28}" + "".join(f"{label:>11}" for label in columns))
    for label, run in runs.items():
        counts = (len(beyond(values)) for values in ways(run).values())
        print(f"{label:28}" + "".join(f"{count:11d}" for count in counts))
    print()
    for weight in (3e2, 3e4, 3e6, 3e14):
        worst = max(abs(error) for error in weighted(record, weight).values())
        print(f"C = {weight:.0e} in dimensionless equations: largest error {worst:.3g} %")
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        figures(folder, record, order)


if __name__ == "__main__":
    main()
