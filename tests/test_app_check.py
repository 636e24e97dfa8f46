"""The page that checks a log before anything else."""

from __future__ import annotations

from pathlib import Path

from app_pages import following, opened, own_shelf, ship_folder  # noqa: F401

from oed_sysid import load_problem, read_csv, write_csv


def test_check_page_names_a_wrong_log_and_offers_copies(ship: Path) -> None:
    """Swapped columns are named on the page Check, with corrected copies to take away."""
    from oed_sysid.app.visit import desk

    app = opened(ship)
    app.button_group[0].set_value("My CSV files").run()
    table = (ship / "data" / "zigzag_20_20.csv").read_text().splitlines()
    names = table[0].split(",")
    first, second = (next(i for i, n in enumerate(names) if n.startswith(k)) for k in ("psi", "r "))
    swapped = names.copy()
    swapped[first] = (
        names[first].replace("psi", "r").replace("deg", "deg/s").replace("rad", "rad/s")
    )
    swapped[second] = names[second].replace("r [", "psi [").replace("/s", "")
    content = "\n".join([",".join(swapped), *table[1:]]) + "\n"
    app.file_uploader[0].set_value([("log.csv", content.encode(), "text/csv")]).run()
    app = following(app)
    desk().wait()
    app = app.run()
    assert not app.exception
    assert "Log suspect" in app.error[0].value
    assert "swap" in app.error[0].value
    assert "Corrected copies (ZIP)" in {one.label for one in app.get("download_button")}
    assert not app.warning


def test_check_page_says_what_it_does_not_correct(ship: Path) -> None:
    """A heading of another run is no fault that a copy could undo."""
    from oed_sysid.app.visit import desk

    channels = load_problem(ship).channels
    runs = read_csv([ship / "data" / f"zigzag_{k}.csv" for k in ("10_10", "20_20")], channels)
    n = min(len(run.times) for run in runs)
    run = runs[0].window(runs[0].times[0], runs[0].times[n - 1])
    outputs = run.outputs.copy()
    psi = run.channels.output_names.index("psi")
    outputs[:, psi] = runs[1].outputs[:n, psi][::-1]
    wrong = ship / "wrong.csv"
    write_csv(run.with_outputs(outputs), wrong)
    app = opened(ship)
    app.button_group[0].set_value("My CSV files").run()
    app.file_uploader[0].set_value([("log.csv", wrong.read_bytes(), "text/csv")]).run()
    app = following(app)
    desk().wait()
    app = app.run()
    assert any(one.value.startswith("Not corrected: ") for one in app.warning)
