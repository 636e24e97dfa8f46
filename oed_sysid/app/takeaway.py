"""The pages Report and Export: everything to take home, and what repeats it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import streamlit as st

from oed_sysid import Fit, OedSysidError
from oed_sysid.app import visit
from oed_sysid.app.panels import download, message, written, zipped
from oed_sysid.app.trust import folder_of
from oed_sysid.app.visit import Asked
from oed_sysid.cli.script import whole
from oed_sysid.cli.study import Outcome, Study, digest
from oed_sysid.cli.tasks import TASKS, Played, write_runs
from oed_sysid.design import Design
from oed_sysid.export import KINDS, export
from oed_sysid.runtime.files import make_folder

# Endings of a problem folder's files that belong to it, and the largest of them, bytes.
_OF_A_PROBLEM, _LARGEST = (".py", ".md", ".toml", ".txt"), 5_000_000
# Reports in the order of the work; effects are kept of those that a search has found.
_FILES = [file for task in TASKS for file in ((task, "kept") if task == "improve" else (task,))]
_ORDER = {file: place for place, file in enumerate(_FILES)}

Finished = Iterable[tuple[Asked, Outcome]]


def show(study: Study) -> None:
    """Draw the page Report: what was done, in the order of the work, and what repeats it."""
    st.session_state["read"] = True
    done = finished(study)
    if not done:
        st.write("Nothing has been computed for these records yet.")
    for about, outcome in done:
        left, right = st.columns([5, 1], vertical_alignment="center")
        if outcome.page is not None:
            with left:
                st.markdown(f"**{about.title}**")
                st.caption("".join(outcome.page.first[:1]))
            with right:
                download("Report (HTML)", outcome.page.html, f"{about.file}.html", wide=True)
    st.subheader("The same in Python")
    code = whole(study, [about.code for about, _ in done])
    download("Script (study.py)", lambda: code, "study.py")
    with st.expander("Show it"):
        st.code(code, language="python", wrap_lines=True)
    st.subheader("The same on the command line")
    st.caption("In the folder where the records were unpacked.")
    st.code(commands(done) or "# nothing yet", language="bash", wrap_lines=True)
    _everything(study, done)


def give(study: Study) -> None:
    """Draw the page Export: the fitted models, and all that belongs to them."""
    done = finished(study)
    if fits := fits_of(done):
        _models(fits)
    else:
        st.info("There is no fitted model of these records yet.")
    _everything(study, done)


def _everything(study: Study, done: list[tuple[Asked, Outcome]]) -> None:
    """Offer the records, the folder of the problem, and all of the study."""
    st.subheader("Records, folder, everything")
    st.caption(
        "The folder is the problem with these records and fits. Everything is the records, "
        "reports, fits, commands and script of this study."
    )
    folder, fits = f"{study.problem.name}.zip", fits_of(done)
    offers = (
        ("Records (ZIP)", partial(zipped, partial(write_records, study)), "records.zip"),
        ("Problem folder (ZIP)", partial(problem_archive, study, fits), folder),
        ("Everything (ZIP)", partial(zipped, partial(write_all, study, done)), "study.zip"),
    )
    for column, (label, content, file) in zip(st.columns(3), offers, strict=True):
        with column:
            download(label, content, file, wide=True)


def results(study: Study) -> dict[str, Outcome]:
    """Outcomes of what was done on these records, by the names of their reports."""
    return {about.file: outcome for about, outcome in finished(study)}


def finished(study: Study) -> list[tuple[Asked, Outcome]]:
    """What was computed for a study, one entry per report."""
    found: dict[str, tuple[Asked, Outcome]] = {}
    these = {digest(*one.key) for one in (study, study.without_records())}
    for key, about in visit.asked().items():
        job = visit.desk().find(visit.study_id(), key) if about.about in these else None
        if job is not None and job.state == "done":
            found[about.file] = (about, job.result)
    return sorted(found.values(), key=lambda one: _ORDER.get(one[0].file, len(_ORDER)))


def fits_of(done: Finished) -> dict[str, Fit]:
    """Fitted models by what they are called; the latest of a name."""
    return {name: fit for _, outcome in done for name, fit in outcome.fits.items()}


def file_of(name: str) -> str:
    """Name of the file of a fitted model.

    >>> file_of("with a and b")
    'with_a_and_b.json'
    """
    return "".join(letter if letter.isalnum() else "_" for letter in name) + ".json"


def _models(fits: Mapping[str, Fit]) -> None:
    """Offer the fits, and their models for other programs."""
    left, middle, right = st.columns([2, 2, 2], vertical_alignment="bottom")
    best = "improved" if "improved" in fits else next(iter(fits))
    name = left.selectbox("Model", list(fits), key=visit.preset(visit.kept("model"), best))
    kinds: dict[str, Any] = {"format_func": KINDS.__getitem__, "key": visit.kept("kind")}
    kind = middle.selectbox("For", list(KINDS), **kinds)
    if name not in fits or kind not in KINDS:
        return
    fit, file = fits[name], file_of(name)
    made: dict[tuple[str, str, str], bytes] = st.session_state.setdefault("exports", {})
    here = (name, kind, repr(fit.cost))
    trim = _trim(fit) if kind == "control" else {}
    with right:
        if st.button("Write the model", key="export", type="primary"):
            made.pop(here, None)
            try:
                with st.spinner("Writing"):
                    made[here] = model_archive(fit, kind, trim)
            except OedSysidError as error:
                message(str(error))
    left, right, _ = st.columns(3)
    with left:
        # What `oed-sysid fit --save` writes: for `report`, `export` and Fit.load.
        download(f"Fit ({file})", partial(written, "fit.json", fit.save), file)
    if here in made:
        with right:
            packed = f"{file.removesuffix('.json')}_{kind}.zip"
            download(f"Model ({kind}, ZIP)", lambda: made[here], packed)


def _trim(fit: Fit) -> dict[str, float]:
    """Ask at which inputs the model is made linear."""
    inputs = fit.model.inputs
    return {
        channel.name: column.number_input(
            f"Trim: {channel.name} [{channel.unit or '-'}]", value=0.0, format="%.4g",
            key=visit.kept("trim", fit.model.name, channel.name),
        )
        for column, channel in zip(st.columns(max(len(inputs), 3)), inputs, strict=False)
    }  # fmt: skip


# -- files -------------------------------------------------------------------------------


def model_archive(fit: Fit, kind: str, trim: Mapping[str, float] | None = None) -> bytes:
    """The model of a fit for another program, as a ZIP file.

    Parameters
    ----------
    fit : Fit
        Whose model it is.
    kind : str
        One of :data:`oed_sysid.export.KINDS`.
    trim : mapping of str to float, optional
        For ``"control"``: inputs and states of the trim, SI.

    Raises
    ------
    OedSysidError
        If the model cannot be written so.
    """
    return zipped(lambda folder: export(fit, kind, folder, trim=trim or None))


def write_records(study: Study, folder: Path) -> None:
    """Write the folders ``train`` and ``test``, one CSV file per record."""
    for part, dataset in (("train", study.train), ("test", study.test)):
        if dataset is not None:
            write_runs(dataset, folder / part)


def problem_archive(study: Study, fits: Mapping[str, Fit]) -> bytes:
    """The folder of the problem with the records of the study and its fits, as a ZIP file."""

    def write(place: Path) -> None:
        write_records(study, place)
        folder = folder_of(study.source)
        for file in sorted(folder.rglob("*")):
            parts = file.relative_to(folder).parts
            hidden = any(part.startswith((".", "__pycache__")) for part in parts)
            fits_in = file.suffix in _OF_A_PROBLEM or parts[0] == "data"
            if file.is_file() and not hidden and fits_in and file.stat().st_size <= _LARGEST:
                make_folder(place.joinpath(*parts).parent)
                place.joinpath(*parts).write_bytes(file.read_bytes())
        for name, fit in fits.items():
            fit.save(place / file_of(name))

    return zipped(write, f"{study.problem.name}/")


def commands(done: Finished) -> str:
    """Commands that repeat what was computed."""
    return "\n".join(dict.fromkeys(line for a, _ in done for line in a.command.splitlines()))


def write_all(study: Study, done: list[tuple[Asked, Outcome]], place: Path) -> None:
    """Write records, reports, fits, commands, script and a designed trial."""
    write_records(study, place)
    (place / "commands.sh").write_text(commands(done) + "\n", encoding="utf-8")
    code = whole(study, [about.code for about, _ in done])
    (place / "study.py").write_text(code, encoding="utf-8")
    for name, fit in fits_of(done).items():
        fit.save(place / file_of(name))
    for about, outcome in done:
        if outcome.page is not None:
            outcome.page.write(place / f"{about.file}.html")
        if isinstance(outcome.result, Design):
            list(Played(place / "design.csv", place / "card.txt").write(outcome, study))
