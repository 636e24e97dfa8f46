r"""Forces measured at given motion, in one likelihood with free-running records.

A captive test, a bollard pull, a point of a polar or of a speed trial says what the forces are
where the motion is given. With motions :math:`x_j`, inputs :math:`u_j` and forces
:math:`F_j` (zero where the motion is known to be steady),

.. math::
    -2 \log L(p) = \sum_k \frac{|y_k - h(x_k(p), u_k, p)|^2}{\sigma^2}
        + \sum_j \frac{|F_j - F(x_j, u_j, p)|^2}{\sigma_F^2} .

Both sums are one model's: the *towed* model has the velocities twice, those that it integrates
and those that forces see, and an input ``towed`` that says which of the two the latter are; its
other states stand still where it is towed. The tests are then one more record of that model, in
which only forces are measured and whose samples are independent: their order says nothing, no
disturbance force or colour links them, and where they scatter more than their noise allows the
covariance is that of White (:mod:`oed_sysid.likelihood.covariance`). Where effects of the model
remember, such as a rudder that lags, each test is a record of its own and begins at rest.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from inspect import signature

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.data.record import MINIMUM_SAMPLES
from oed_sysid.errors import DataError, ModelError, UnitWarning, located
from oed_sysid.likelihood.disturbances import equation_units
from oed_sysid.likelihood.estimate import CaptiveErrors
from oed_sysid.likelihood.estimator import Estimator
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.unknowns import StartState
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import ROUNDING

TOWED = "towed"
_FORCE = "force_{}"
_HELD = "{}_held"
_OWN = "{}_free"


@dataclass(frozen=True, eq=False)
class CaptiveTests:
    """A series of tests: the motion is given, forces are measured.

    Parameters
    ----------
    name : str
        Name of the series.
    motions : mapping of str to array_like (n_tests,)
        Held velocities, by state that an axis of the model moves, m/s and rad/s; states that
        are not named are zero.
    inputs : mapping of str to array_like (n_tests,)
        Inputs of the model.
    forces : mapping of str to array_like (n_tests,)
        Sum of all forces by axis, N or N m, those of the model's own centripetal terms
        included; NaN where not measured, zero where the motion is steady.
    noise : mapping of str to float
        Standard deviation by axis, how far a model is believed included.

    Examples
    --------
    A bollard pull tells the thrust, and towing without a propeller the resistance:

    >>> from oed_sysid import Force, MultipleShooting, Parameter, State
    >>> ship = Model(
    ...     "surge", (State("u", "m/s"),), (Input("n", "1/s"),), (Output("u", "m/s"),),
    ...     axes={"X": "u"}, inertia={("X", "u"): "100"},
    ...     effects=(Force("sum", {"X": "k*n*n - R*u*u"},
    ...         (Parameter("k", 0.5, "N s^2"), Parameter("R", 1.0, "kg/m"))),),
    ... )
    >>> tests = CaptiveTests(
    ...     "basin", {"u": [0.0, 0.0, 1.0, 2.0]}, {"n": [2.0, 4.0, 0.0, 0.0]},
    ...     {"X": [0.8, 3.2, -3.0, -12.0]}, {"X": 0.1},
    ... )
    >>> fit = tests.fit(MultipleShooting(), ship)
    >>> print({name: round(value, 3) for name, value in fit.values.items()})
    {'k': 0.2, 'R': 3.0}
    """

    name: str
    motions: Mapping[str, np.ndarray] = field(repr=False)
    inputs: Mapping[str, np.ndarray] = field(repr=False)
    forces: Mapping[str, np.ndarray] = field(repr=False)
    noise: Mapping[str, float]

    def __post_init__(self) -> None:
        for what in ("motions", "inputs", "forces"):
            columns = {k: np.array(v, dtype=float) for k, v in getattr(self, what).items()}
            object.__setattr__(self, what, columns)
        for words in self._faults():
            raise DataError(f"Captive tests {self.name!r}{words}")

    def _faults(self) -> Iterator[str]:
        """What is wrong with the tests, one after the other."""
        given = [*self.motions.items(), *self.inputs.items()]
        for name, column in given:
            if not np.isfinite(column).all():
                yield f": {name} has values that are not finite. Leave these tests out."
        shapes = {column.shape for _, column in (*given, *self.forces.items())}
        if [*map(len, shapes)] != [1]:
            listed = ", ".join(map(str, sorted(shapes)))
            yield f" have columns of shapes {listed}; expected one value per test in each."
        if not self.forces:
            yield " have no force. Give at least one axis."
        if not self.n_tests:
            yield " are none. Give at least one test."
        for axis in self.forces:
            noise = self.noise.get(axis)
            if not (noise or 0.0) > 0.0:
                yield f": the noise of {axis} is {noise}. Give its standard deviation, above zero."

    @property
    def n_tests(self) -> int:
        """Number of tests."""
        return len(next(iter(self.forces.values())))

    def shared(self, other: CaptiveTests) -> int:
        """Number of these tests that another series holds too.

        One and the same are tests with the same motion, inputs and force about some axis.

        Examples
        --------
        >>> speeds = {"u": [1.0, 2.0, 3.0]}
        >>> tests = CaptiveTests("all", speeds, {}, {"X": [-2.1, -7.9, -18.2]}, {"X": 0.2})
        >>> tests.shared(CaptiveTests("one", {"u": [2.0]}, {}, {"X": [-7.9]}, {"X": 0.2}))
        1
        """
        same = np.ones((self.n_tests, other.n_tests), dtype=bool)
        for own, others in ((self.motions, other.motions), (self.inputs, other.inputs)):
            for name in {*own, *others}:
                mine = own.get(name, np.zeros(self.n_tests))
                theirs = others.get(name, np.zeros(other.n_tests))
                same &= np.isclose(mine[:, None], theirs, rtol=ROUNDING, atol=0.0)
        alike = np.zeros_like(same)
        for axis in self.forces.keys() & other.forces.keys():
            mine, theirs = self.forces[axis], other.forces[axis]
            alike |= np.isclose(mine[:, None], theirs, rtol=ROUNDING, atol=0.0)
        return int((same & alike).any(axis=1).sum())

    def towed(self, model: Model) -> Model:
        """Return the model with inputs that hold its velocities, and outputs that are forces.

        Raises
        ------
        ModelError
            If the model has no such state, input or axis.
        """
        self._check(model)
        moved = {state: _OWN.format(state) for state in model.axes.values()}
        own = {s.name: moved.get(s.name, s.name) for s in model.states}
        signals = {
            # A switch in the equations: forces see the given motion where towed, else their own.
            state: f"{free} + {TOWED}*({_HELD.format(state)} - {free})"
            for state, free in moved.items()
        }
        held = [
            Input(_HELD.format(s.name), s.unit, f"given {s.label or s.name}")
            for s in model.states
            if s.name in moved
        ]
        units = equation_units(model)
        outputs = [
            replace(o, expression=moved[o.source]) if o.source in moved else o
            for o in model.outputs
        ]
        return replace(
            model,
            name=f"{model.name}, towed",
            states=tuple(replace(s, name=own[s.name]) for s in model.states),
            inputs=(*model.inputs, Input(TOWED, "1", "1 where the motion is given"), *held),
            outputs=(*outputs, *(self._force(axis, units[axis]) for axis in self.forces)),
            kinematics={s: f"(1 - {TOWED})*({text})" for s, text in model.kinematics.items()},
            axes={axis: own[state] for axis, state in model.axes.items()},
            inertia={(axis, own[s]): text for (axis, s), text in model.inertia.items()},
            signals={**signals, **model.signals},
        )

    def _force(self, axis: str, unit: str) -> Output:
        """What a towed model measures about an axis."""
        return Output(
            _FORCE.format(axis),
            unit,
            f"force of {axis}",
            expression=f'force("{axis}")',
            noise_std=self.noise[axis],
        )

    def _check(self, model: Model) -> None:
        for signal in model.inputs:
            largest = np.max(np.abs(self.inputs.get(signal.name, 0.0)))
            if signal.unit == "rad" and largest > np.pi:
                warnings.warn(
                    f"Captive tests {self.name!r}: input {signal.name!r} reaches {largest:.4g} "
                    "rad, more than half a turn. If these are degrees, give np.radians(...).",
                    UnitWarning,
                    stacklevel=2,
                )
        velocities = tuple(model.axes.values())
        none, advice = f": model {model.name!r} has no", "Add it to inputs; zero is a value too."
        for lacking, names, known, more in (
            (f"{none} velocity of an axis", self.motions, velocities, ""),
            (f"{none} input", self.inputs, model.input_names, ""),
            (f"{none} axis", self.forces, model.axes, ""),
            (" lack the input", model.input_names, self.inputs, advice),
        ):
            located(ModelError, f"Captive tests {self.name!r}{lacking}", names, known, more)
        if model.kinematics.keys() & set(velocities):
            raise ModelError(f"Model {model.name!r} moves a velocity without an axis.")

    def records(self, model: Model) -> tuple[Record, ...]:
        """Return the tests as records of the towed model; their clock only counts them.

        One record, or one for each test where the model has a memory. A record that would be too
        short repeats its last test with nothing measured.
        """
        towed, n = self.towed(model), self.n_tests
        columns = {**self.inputs, TOWED: np.ones(n)}
        columns |= {
            _HELD.format(state): self.motions.get(state, np.zeros(n))
            for state in model.axes.values()
        }
        measured = {_FORCE.format(axis): values for axis, values in self.forces.items()}
        nothing = np.full(n, np.nan)
        inputs = np.column_stack([columns[name] for name in towed.input_names])
        outputs = np.column_stack([measured.get(name, nothing) for name in towed.output_names])
        if not _remembers(model):
            return (self._record(self.name, towed, inputs, outputs),)
        # What has a memory must not remember the test before: each is a record of its own.
        seen = np.flatnonzero(np.isfinite(outputs).any(axis=1))
        return tuple(
            self._record(f"{self.name} {i + 1}", towed, inputs[[i]], outputs[[i]]) for i in seen
        )

    def _record(self, name: str, towed: Model, inputs: np.ndarray, outputs: np.ndarray) -> Record:
        n = len(inputs)
        # The last test again, without its forces, until a record has its least length.
        rows = np.minimum(np.arange(max(n, MINIMUM_SAMPLES)), n - 1)
        outputs = np.where((np.arange(len(rows)) < n)[:, None], outputs[rows], np.nan)
        empty = np.isnan(outputs).all(axis=0)
        return Record(
            name,
            towed.step * np.arange(len(rows)),
            inputs[rows],
            outputs,
            towed.channels,
            missing_outputs=tuple(
                name for name, none in zip(towed.output_names, empty, strict=True) if none
            ),
            independent=True,
        )

    def predict(self, model: Model) -> dict[str, np.ndarray]:
        """Forces by axis, ``(n_tests,)``, that the model at its values says."""
        asked = replace(self, forces={axis: np.zeros(self.n_tests) for axis in self.forces})
        towed = self.towed(model)
        towed = towed.fix(*towed.free_names)
        compiled, values = kernel(towed), towed.value_vector
        parts = []
        for record in asked.records(model):
            still = np.zeros(compiled.n_own)
            run = compiled.simulate(record.times, record.inputs, values, still)
            parts.append(run.outputs[np.isfinite(record.outputs).any(axis=1)])
        found, names = np.vstack(parts), towed.output_names
        return {axis: found[:, names.index(_FORCE.format(axis))] for axis in self.forces}

    def relative_errors(self, model: Model) -> dict[str, float]:
        """Rms error of the model's forces over their own rms, by axis."""
        return dict(self.errors(model).relative)

    def errors(self, model: Model) -> CaptiveErrors:
        """Rms errors of the model's forces over their own rms, and over their noise, by axis."""
        found, relative, in_noise = self.predict(model), {}, {}
        for axis, measured in self.forces.items():
            seen = np.isfinite(measured)
            size = float(np.linalg.norm(measured[seen]))
            error = float(np.linalg.norm((found[axis] - measured)[seen]))
            relative[axis] = error / size if size > 0.0 and np.isfinite(error) else np.inf
            count = int(seen.sum())
            in_noise[axis] = error / np.sqrt(count) / self.noise[axis] if count else np.nan
        return CaptiveErrors(relative, in_noise)

    def fit(self, estimator: Estimator, model: Model, dataset: Dataset | None = None) -> Fit:
        """Fit a model to these tests and to free-running records together.

        Parameters
        ----------
        estimator : Estimator
            Such as :class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting`.
        model : Model
            Of the free-running vessel.
        dataset : Dataset, optional
            Free-running records; without them the tests stand alone.

        Returns
        -------
        Fit
            Of ``model`` to ``dataset``, with what both have told; ``fit.captive`` has the errors
            of the forces. Of the towed model where there is no free-running record.
        """
        if "start_states" not in signature(estimator.fit).parameters:
            raise ModelError(
                f"Captive tests {self.name!r} need an estimator that is told their start states "
                f"(start_states=), such as MultipleShooting; {type(estimator).__name__} is not."
            )
        towed, tests = self.towed(model), self.records(model)
        if not tests:
            raise DataError(
                f"Captive tests {self.name!r} have no measured force. Give at least one."
            )
        # Own states of a towed model move nothing; held at zero they are no unknowns.
        still = {state.name: 0.0 for state in towed.states}
        records = [self._free(model, towed, record) for record in dataset or ()]
        whole = Dataset((*records, *tests))
        known: list[StartState] = [{} for _ in records] + [still] * len(tests)
        fit = estimator.fit(towed, whole, start_states=known)  # type: ignore[call-arg]
        fitted = model.with_values(fit.model.values)
        fit = replace(fit, captive=self.errors(fitted))
        if dataset is None:
            return fit
        n, n_outputs = len(records), len(model.outputs)
        return replace(
            fit,
            model=fitted,
            dataset=dataset,
            estimator=f"{fit.estimator}, with captive tests {self.name}",
            sigma=fit.sigma[:n_outputs],
            sigma_estimated=fit.sigma_estimated[:n_outputs],
            predictions=tuple(part[:, :n_outputs] for part in fit.predictions[:n]),
            residuals=tuple(part[:, :n_outputs] for part in fit.residuals[:n]),
            states=fit.states[:n],
            initial_states=fit.initial_states[:n],
            local_values=fit.local_values[:n],
            start_states=fit.start_states[:n],
            noise=None,  # type: ignore[arg-type]  # white
            innovations=None,
            innovation_std=None,
        )

    def _free(self, model: Model, towed: Model, record: Record) -> Record:
        """A free-running record with the channels of the towed model."""
        n = record.n_samples
        outputs = np.full((n, len(towed.outputs)), np.nan)
        outputs[:, : len(model.outputs)] = record.outputs
        forces = tuple(_FORCE.format(axis) for axis in self.forces)
        return Record(
            record.name,
            record.times,
            np.hstack([record.inputs, np.zeros((n, len(towed.inputs) - len(model.inputs)))]),
            outputs,
            towed.channels,
            record.source,
            (*record.missing_outputs, *forces),
        )


def _remembers(model: Model) -> bool:
    """Whether forces depend on time or on what was before."""
    return any(
        effect.stage != "sensor" and (effect.states or effect.memory or "t" in effect.uses())
        for effect in model.effects
    )
