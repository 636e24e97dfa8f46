"""Normal equations of segments: compiled sums against sums of the kernel's own sensitivities."""

from __future__ import annotations

import numpy as np
import pytest
from vehicles import DIVING_START, remus
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid.compiled.kernels import Kernel
from oed_sysid.compiled.normal_equations import eliminate, gather
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics.model import Model

SIGMA = np.array([0.02, 0.02, 0.004, 0.004, 0.03])


def dive(n: int = 120) -> tuple[Model, np.ndarray, np.ndarray, np.ndarray]:
    """Model, times, inputs and outputs of a dive, some samples missing."""
    model, times = remus(), 0.1 * np.arange(n)
    inputs = {"fin_command": 0.1 * np.sign(np.sin(times)), "thrust": 9.0}
    run = simulate_inputs(model, times, inputs=inputs, initial=DIVING_START)
    outputs = run.outputs + 0.01 * np.random.default_rng(0).standard_normal(run.outputs.shape)
    outputs[5:17, 1] = np.nan
    outputs[30] = np.nan
    return model, times, run.inputs, outputs


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("length", [2, 7, 200])
def test_sums_are_those_of_the_sensitivities(length: int, compiled: bool) -> None:
    """Each block holds the products of scaled rows and residuals, missing samples left out."""
    model, times, inputs, outputs = dive(40 if not compiled else 120)
    kernel = Kernel(model, compiled=compiled)
    starts = np.arange(0, len(times), length, dtype=np.intc)
    nodes = np.tile([1.5, 0.0, 0.02, -0.01, 10.0], (len(starts), 1))
    nodes[:, 1] = 0.01 * np.arange(len(starts))
    values = 0.8 * model.value_vector
    blocks = gather(
        kernel, times, inputs, values, nodes, outputs, SIGMA, starts=starts, linked=True
    )
    run = kernel.run(times, inputs, values, nodes, starts=starts, sensitivities=True)
    for i, first in enumerate(starts):
        rows = []
        for k in range(first, min(first + length, len(times))):
            for j in range(5):
                if np.isfinite(outputs[k, j]):
                    residual = outputs[k, j] - run.outputs[k, j]
                    rows.append(np.append(run.output_sensitivities[k, j], residual) / SIGMA[j])
        expected = np.array(rows).T @ np.array(rows)
        assert np.allclose(blocks.gram[i], expected, rtol=1e-10, atol=1e-12 * expected.max())
    assert np.array_equal(blocks.ends, run.ends)
    assert np.array_equal(blocks.end_sensitivities, run.end_sensitivities)


def test_segments_without_ends_have_the_same_sums() -> None:
    """Where ends are not wanted the sums stay what they are."""
    model, times, inputs, outputs = dive()
    starts = np.arange(0, len(times), 4, dtype=np.intc)
    nodes = np.nan_to_num(outputs[starts])
    both = [
        gather(
            Kernel(model),
            times,
            inputs,
            model.value_vector,
            nodes,
            outputs,
            SIGMA,
            starts=starts,
            linked=linked,
        )
        for linked in (True, False)
    ]
    assert np.array_equal(both[0].gram, both[1].gram)
    assert both[1].ends is None


@pytest.mark.parametrize("compiled", [True, False])
def test_explosion_is_said(compiled: bool) -> None:
    """A trajectory that diverges gives None."""
    model, record = yaw_model().with_values({"alpha": -1e12}), yaw_data(1)[0]
    blocks = gather(
        Kernel(model, compiled=compiled),
        record.times,
        record.inputs,
        model.value_vector,
        np.array([[0.0, 1.0]]),
        record.outputs,
        NOISE,
        starts=np.zeros(1, dtype=np.intc),
        linked=False,
    )
    assert blocks is None


def test_elimination_solves_the_whole_problem() -> None:
    """Parameters and start states are those of one dense system of all unknowns."""
    rng = np.random.default_rng(1)
    n_segments, n_full, n_free = 6, 5, 8
    rows = rng.standard_normal((n_segments, 30, n_full + n_free + 1))
    gram = rows.transpose(0, 2, 1) @ rows
    away, weight = rng.standard_normal((n_segments, n_full)), rng.uniform(0.5, 2.0, n_full)
    found = eliminate(gram, away, weight, 0.1)
    size = n_segments * n_full
    matrix, right = np.zeros((size + n_free, size + n_free)), np.zeros(size + n_free)
    for i in range(n_segments):
        own = np.arange(i * n_full, (i + 1) * n_full)
        columns = np.concatenate([own, size + np.arange(n_free)])
        block = gram[i].copy()
        block[range(n_full), range(n_full)] += weight
        block[range(n_full), range(n_full)] *= 1.1
        block[:n_full, -1] -= weight * away[i]
        matrix[np.ix_(columns, columns)] += block[:-1, :-1]
        right[columns] += block[:-1, -1]
    expected = np.linalg.solve(matrix, right)
    step = np.linalg.solve(found.matrix, found.right)
    assert np.allclose(step, expected[size:], rtol=1e-9)
    assert np.allclose(
        (found.solved[:, :, -1] - found.solved[:, :, :-1] @ step).ravel(),
        expected[:size],
        rtol=1e-9,
    )
    # Twice the drop of the quadratic: right-hand side times solution.
    assert found.gain + found.right @ step == pytest.approx(right @ expected, rel=1e-9)


def test_start_states_that_look_alike_do_not_stop_the_step() -> None:
    """Blocks that are singular give a finite step, and the exact one elsewhere."""
    column = np.array([1e12, -1e12, 0.5, 1.0])
    alike = np.outer(column, column)
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((6, 4))
    gram, away, weight = np.stack([alike, rows.T @ rows]), np.zeros((2, 2)), np.full(2, 1e-12)
    found = eliminate(gram, away, weight, 0.0)
    assert np.isfinite(found.solved).all()
    block = rows.T @ rows
    exact = np.linalg.solve(block[:2, :2] + np.diag(weight), block[:2, 2:])
    np.testing.assert_allclose(found.solved[1], exact, rtol=1e-10)
