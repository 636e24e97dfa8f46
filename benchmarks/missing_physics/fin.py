"""The fin of the simulated vehicle, between command and angle."""

from __future__ import annotations

from typing import Protocol

import numpy as np

SAMPLE, SUBSTEPS = 0.1, 10
STEP = SAMPLE / SUBSTEPS


class Amplitudes(Protocol):
    """Where the fin's effects have their sizes from."""

    def of(self, name: str) -> np.ndarray:
        """Amplitude of an effect in every case."""
        ...


class Fin:
    """From fin command to fin angle: delay, dead band, play, rate limit, lag, offset, stall."""

    def __init__(self, truth: Amplitudes, first: np.ndarray) -> None:
        self.truth = truth
        self.commands = [first]
        self.play = self._dead(first)
        self.angle = self.play.copy()

    def command(self, command: np.ndarray) -> None:
        """Take the command of the next sample."""
        self.commands.append(command.copy())

    def _dead(self, angle: np.ndarray) -> np.ndarray:
        half = self.truth.of("fin_deadband")
        return np.sign(angle) * np.maximum(abs(angle) - half, 0.0)

    def _delayed(self, sub: int) -> np.ndarray:
        """Mean over one substep of the command a delay ago."""
        if not np.any(self.truth.of("fin_delay")):
            return self.commands[-1]
        history = np.stack(self.commands)
        newest = len(self.commands) - 1
        # Time since the newest command came, in samples, at both ends of the substep.
        begin = newest + sub / SUBSTEPS - self.truth.of("fin_delay") / SAMPLE
        end = begin + 1 / SUBSTEPS
        early = np.clip(np.floor(begin + 1e-9).astype(int), 0, newest)
        late = np.clip(np.floor(end - 1e-9).astype(int), 0, newest)
        share = np.where(late > early, (end - late) * SUBSTEPS, 1.0)
        every = np.arange(len(begin))
        return share * history[late, every] + (1 - share) * history[early, every]

    def advance(self, sub: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fin angle at the start, middle and end of the next substep."""
        of = self.truth.of
        wanted = self._dead(self._delayed(sub))
        half = of("fin_backlash")
        self.play = np.clip(self.play, wanted - half, wanted + half)
        lag, limit = of("fin_lag"), of("fin_rate_limit")
        begin = self.angle
        parts = [begin]
        for share in (0.5, 1.0):
            toward = np.where(lag > 0, 1 - np.exp(-share * STEP / np.maximum(lag, 1e-9)), 1.0) * (
                self.play - begin
            )
            reach = np.where(limit > 0, share * STEP * limit, np.inf)
            parts.append(begin + np.clip(toward, -reach, reach))
        if not (np.any(lag) or np.any(limit)):
            parts[0] = self.play
        else:
            held = (lag == 0) & (limit == 0)
            parts[0] = np.where(held, self.play, begin)
        self.angle = parts[2]
        offset, stall = of("fin_offset"), of("fin_stall")
        done = []
        for part in parts:
            angle = part + offset
            done.append(angle * (1 - stall * angle**2))
        return done[0], done[1], done[2]
