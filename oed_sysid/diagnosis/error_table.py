"""Prediction errors in the units of the measured signals, for whoever knows the instruments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.channels import Output
from oed_sysid.data.dataset import Dataset
from oed_sysid.fitting.fit import align
from oed_sysid.fitting.noise_levels import signal_spread

# Root mean square errors of every output, ``(n_outputs,)``, on ``train`` and ``test`` records.
Errors = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What errors are compared with.

    Attributes
    ----------
    outputs : tuple of Output
    sigma : ndarray (n_outputs,)
        Noise levels.
    spread : ndarray (n_outputs,)
        Standard deviation of each signal over the training records.
    """

    outputs: tuple[Output, ...]
    sigma: np.ndarray
    spread: np.ndarray

    @classmethod
    def of(cls, dataset: Dataset, sigma: np.ndarray) -> Yardstick:
        """Yardstick of the training records."""
        return cls(dataset.channels.outputs, sigma, signal_spread(dataset))

    def table(self, before: Errors, after: Errors | None) -> list[str]:
        """Errors of the believed and the improved model as lines of text."""
        return [*align(self.rows(before, after)), *self.notes()]

    def rows(self, before: Errors, after: Errors | None) -> list[tuple[str, ...]]:
        """Errors in units and per cent of the signal, the header first."""
        kinds = [k for k in ("train", "test") if not np.isnan(before[k]).all()]
        models = [before, *([after] if after else [])]
        rows: list[tuple[str, ...]] = [
            ("error", "records", "as believed", *(["improved"] if after else []), "noise", "unit")
        ]
        for index, output in enumerate(self.outputs):
            # Angles are read in degrees.
            angle = output.unit.startswith("rad")
            factor = np.degrees(1.0) if angle else 1.0
            for kind in kinds:
                rows.append(
                    (
                        output.name,
                        {"train": "training", "test": "untouched"}[kind],
                        *(self._cell(errors[kind][index], index, factor) for errors in models),
                        f"{factor * self.sigma[index]:.2g}",
                        output.unit.replace("rad", "deg", 1) if angle else output.unit,
                    )
                )
        return rows

    def notes(self) -> Sequence[str]:
        """Where noise levels are from, if nobody declared them."""
        unknown = [output.name for output in self.outputs if output.noise_std is None]
        lines = [
            "Errors are root mean squares over whole records, in per cent of the signal's spread."
        ]
        if unknown:
            lines.append(
                f"The noise of {', '.join(unknown)} was not declared: it is what the fastest "
                "wiggles show, or more where the final model needs it."
            )
        return lines

    def _cell(self, error: float, index: int, factor: float) -> str:
        if not np.isfinite(error):
            return "diverges" if np.isinf(error) else "-"
        return f"{factor * error:.3g} ({_percent(error / self.spread[index])})"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"
