"""Records for a command: read with the channels of its problem, their clock looked at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from oed_sysid.cli.study import Study
from oed_sysid.cli.terminal import asked, note
from oed_sysid.errors import DataError

if TYPE_CHECKING:
    from oed_sysid import Dataset, Model


def study_of(given: Mapping[str, Any]) -> Study:
    """Return the study that the arguments of a command name.

    Raises
    ------
    OedSysidError
        If the problem or its records cannot be read.
    """
    study = Study.named(given["problem"], given["model"])
    model, usual = study.problem.model, [r.sample_time for r in study.problem.experiments.values()]
    train, test = (
        read_records(given[name], model, usual) if given.get(name) else None
        for name in ("files", "validate")
    )
    settings = {name: given[name] for name in ("known_noise", "disturbances") if name in given}
    return replace(study, train=train, test=test, **settings)


def read_records(files: Sequence[str], model: Model, intervals: Iterable[float]) -> Dataset:
    """Read records with the channels of a model, whose samples are usually so far apart, s.

    Raises
    ------
    DataError
        If a file cannot be used, or its times seem to be milliseconds and no ``--time-unit`` says
        what they are.
    """
    from oed_sysid.data.dataset import read_csv

    unit = asked("time_unit")
    dataset = read_csv(files, model.channels, units={"time": unit} if unit else None)
    _say_unmeasured(dataset)
    usual = max([model.step, *intervals])
    for record in dataset:
        interval = record.sample_time
        # Milliseconds under [s] make a log a thousand times as long; a heading that is logged every
        # 3 s for a model with steps of 0.01 s is no such log.
        if not unit and interval >= max(5.0, 200.0 * usual):
            raise DataError(
                f"Record {record.name!r} has a sample every {interval:.4g} s and lasts "
                f"{record.duration / 3600:.3g} h, but {usual:.3g} s is usual for {model.name!r}: "
                "its times seem to be milliseconds. Write the header as 't [ms]', or add "
                "--time-unit ms; if they are seconds, add --time-unit s."
            )
    return dataset


def _say_unmeasured(dataset: Dataset) -> None:
    """Note outputs without a sample in any record: a misnamed column is one, silently left out."""
    import numpy as np

    seen = np.any([np.isfinite(record.outputs).any(axis=0) for record in dataset], axis=0)
    outputs = zip(dataset.channels.outputs, seen, strict=True)
    if absent := [output for output, one in outputs if not one]:
        wanted = ", ".join(repr(output.column or output.name) for output in absent)
        note(
            f"Note: no record measures {', '.join(one.name for one in absent)}: no file has "
            "samples in a column "
            f"{wanted}. If one is meant, rename its header or set Output(column=...)."
        )
