"""How long a fit takes, and from how far away it finds its way.

    OMP_NUM_THREADS=1 python -m benchmarks.fit_speed

The diving plane of a REMUS-like vehicle, eight parameters. *Local*: three
records, 2,400 samples of five outputs, start values 30 % off. *Basin*: one
record of 900 samples, forty starts drawn within four times each true value,
signs included; success is the optimum that a start at the truth reaches. The
last rows leave out sensors, so that states have to be guessed.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.efficiency import NOISE, START, vehicle
from oed_sysid import Dataset, MultipleShooting
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics.model import Model

TESTS = ((90.0, 0.10, 9.0, 14.0), (90.0, 0.20, 6.0, 9.0), (60.0, 0.05, 12.0, 20.0))
N_STARTS, SPAN, REPEATS = 40, 4.0, 15
SENSORS = (("u", "w", "q", "theta", "z"), ("u", "theta", "z"), ("u", "w", "theta"))


def records(model: Model, outputs: tuple[str, ...]) -> tuple[Model, Dataset]:
    """The model with some outputs, and noisy records of it."""
    rng = np.random.default_rng(0)
    part = replace(model, outputs=tuple(o for o in model.outputs if o.name in outputs))
    columns = [model.output_names.index(name) for name in part.output_names]
    result = []
    for index, (duration, amplitude, thrust, period) in enumerate(TESTS):
        times = np.arange(0.0, duration, 0.1)
        fin = amplitude * np.sign(np.sin(2 * np.pi * times / period))
        run = simulate_inputs(
            model, times, inputs={"fin_command": fin, "thrust": thrust}, initial=START
        )
        noisy = run.outputs + NOISE * rng.standard_normal(run.outputs.shape)
        result.append(Record(f"r{index}", times, run.inputs, noisy[:, columns], part.channels))
    return part, Dataset(tuple(result))


def scaled(model: Model, factor: float) -> Model:
    """The model with every free value times a factor."""
    return model.with_values({name: factor * model.values[name] for name in model.free_names})


def timed(estimator: MultipleShooting, model: Model, data: Dataset) -> tuple[float, object]:
    """Least processor time of some repetitions, ms, and the fit."""
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        fit = estimator.fit(model, data)
        times.append(time.process_time() - began)
    return 1e3 * min(times), fit


def main() -> None:
    """Print the tables."""
    model, data = records(vehicle(), SENSORS[0])
    MultipleShooting(disturbances="none").fit(model, data)
    print("local fit of 2,400 samples        CPU ms  iterations  cost")
    for factor in (0.7, 1.3):
        for noise in ("given", "estimate"):
            least, fit = timed(
                MultipleShooting(disturbances="none", noise=noise), scaled(model, factor), data
            )
            print(
                f"  start x {factor}, noise {noise:9} {least:10.1f} {fit.iterations:8} "
                f"{fit.cost:12.2f}"
            )
    print("wild starts, one record of 900 samples")
    for sensors in SENSORS:
        model, data = records(vehicle(), sensors)
        single = Dataset((data[0],))
        right = MultipleShooting(disturbances="none").fit(model, single)
        local, _ = timed(MultipleShooting(disturbances="none"), scaled(model, 0.7), single)
        arrived, times = 0, []
        for seed in range(N_STARTS):
            rng = np.random.default_rng(seed)
            wild = {n: rng.uniform(-SPAN, SPAN) * abs(model.values[n]) for n in model.free_names}
            began = time.process_time()
            fit = MultipleShooting(disturbances="none").fit(model.with_values(wild), single)
            times.append(1e3 * (time.process_time() - began))
            arrived += fit.status.ok and fit.cost < right.cost + 0.01
        print(
            f"  {', '.join(sensors):18} {arrived}/{N_STARTS} arrive; median {np.median(times):.0f} "
            f"ms, longest {max(times):.0f} ms; a local fit {local:.0f} ms"
        )


if __name__ == "__main__":
    main()
