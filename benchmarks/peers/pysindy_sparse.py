"""pysindy: regression of differentiated measurements on the true terms of the equations."""

from __future__ import annotations

import numpy as np
import pysindy

from benchmarks.peers.task import DETERMINANT, X_UDOT, A, B, C, D, M, load, report


def main() -> None:
    """The right library of terms is given; no other help."""
    times, inputs, outputs = load()

    def solve() -> np.ndarray:
        smooth = pysindy.SmoothedFiniteDifference(smoother_kws={"window_length": 11})
        slope = smooth(outputs, times)
        u, w, q, theta = outputs[:, :4].T
        fin, thrust = inputs.T
        surge = (M - X_UDOT) * slope[:, 0] - thrust + M * q * w
        heave = A * slope[:, 1] + B * slope[:, 2] - M * u * q
        pitch = C * slope[:, 1] + D * slope[:, 2]
        optimizer = pysindy.STLSQ(threshold=0.0, alpha=0.0)

        def fit(columns: list[np.ndarray], target: np.ndarray) -> np.ndarray:
            return optimizer.fit(np.column_stack(columns), target[:, None]).coef_.ravel()

        x = fit([u * u], surge)
        z = fit([u * w, u * q, u * u * fin], heave)
        m = fit([u * w, u * q, u * u * fin, -np.sin(theta)], pitch)
        return np.array([x[0], z[0], z[1], m[0], m[1], z[2], m[2], m[3]])

    assert DETERMINANT > 0
    report(solve, repeats=5)


if __name__ == "__main__":
    main()
