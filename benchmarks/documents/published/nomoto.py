"""Han, Bai, Yu and Lian (2023): Nomoto's K and T from sparse headings, by spirals."""

from __future__ import annotations

import numpy as np

from benchmarks.documents.page import Numbers, paper

SEEDS = 10


def without_noise() -> Numbers:
    """Errors of K and T in per cent and of headings in rad; the first ship is the published one."""
    script = paper("nomoto_sparse_heading")
    rows = {case: _row(script.errors(case, 0.0)) for case in script.CASES}
    published, *others = rows.values()
    gaps = [row["cubic, to 0.1 s"] - row["spiral, to 0.1 s"] for row in rows.values()]
    case = next(iter(script.CASES))
    signed = {way: pair.tolist() for way, pair in script.signed(case).items()}
    spiral, fine = (1 + signed[way][0] / 100 for way in ("spiral", "0.1 s"))
    headings = script.prediction(case)
    return {
        "rows": rows,
        "published": published,
        "others": {way: [row[way] for row in others] for way in published},
        "better": gaps[0],
        "worse": [-gap for gap in gaps[1:]],
        "signed": signed,
        "gain_to_fine": 100 * (spiral / fine - 1),
        "headings": {
            way: float(np.sqrt(np.mean((heading - headings["truth"]) ** 2)))
            for way, heading in headings.items()
            if way != "truth"
        },
    }


def with_noise() -> Numbers:
    """Mean errors against the truth, per cent, over realisations, by ship and noise."""
    script = paper("nomoto_sparse_heading")
    rows = [
        {"case": case, "noise": noise, **_row(script.errors(case, noise, SEEDS))}
        for case in script.CASES
        for noise in script.NOISES
    ]
    noisiest = [row for row in rows if row["noise"] == max(script.NOISES)]
    return {
        "rows": rows,
        "seeds": SEEDS,
        "ships": len(script.CASES),
        "noises": [1e3 * noise for noise in script.NOISES],  # mrad
        "wins": [row["case"] for row in rows if row["spiral"] < row["cubic"]],
        "worst": max(noisiest, key=lambda row: row["spiral"]),
        "shooting": [row["shooting"] for row in rows],
        "times": [min(row["spiral"], row["cubic"]) / row["shooting"] for row in rows],
    }


def _row(errors: np.ndarray) -> dict[str, float]:
    """Errors by the columns of the paper's script."""
    columns = paper("nomoto_sparse_heading").COLUMNS
    return dict(zip(columns, errors.tolist(), strict=True))
