"""PEtab problem Boehm et al. (2014): nine parameters of a signalling pathway."""

from __future__ import annotations

from benchmarks.scoreboard.row import Row, missing, place

FILES = (
    "measurementData_Boehm_JProteomeRes2014.tsv",
    "observables_Boehm_JProteomeRes2014.tsv",
    "parameters_Boehm_JProteomeRes2014.tsv",
    "model_Boehm_JProteomeRes2014.xml",
)
FOLDER = "boehm_2014"
BEST = "138.22 (negative log-likelihood), Benchmark-Models-PEtab"


def score() -> list[Row]:
    """What is missing: the four files, or the reader of their model (SBML)."""
    what = "PEtab Boehm 2014, negative log-likelihood"
    lacking = [name for name in FILES if not place(f"{FOLDER}/{name}").is_file()]
    if lacking:
        return [missing(what, BEST, f"{FOLDER}/", ", ".join(lacking))]
    return [Row(what, None, BEST, note="the files are there; the model's SBML is not read yet")]
