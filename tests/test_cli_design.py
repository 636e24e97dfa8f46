"""The command that designs the next experiment, on a folder as `oed-sysid new` writes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Limits, load_problem
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.cli.limit_words import with_limits
from oed_sysid.errors import DesignError


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The starter folder."""
    folder = tmp_path_factory.mktemp("cli") / "my_ship"
    assert main(["new", str(folder)]) == DONE
    return folder


def test_design_keeps_limits_and_beats_the_zigzags(ship: Path, tmp_path: Path, capsys) -> None:
    """The commands stay in range, and the expected errors are below those of a zigzag."""
    names = ("next.csv", "card.txt", "next.json", "next.html")
    commands, card, stored, page = (tmp_path / name for name in names)
    files = ["--out", str(commands), "--card", str(card), "--json", str(stored)]
    files += ["--html", str(page)]
    arguments = ["design", str(ship), "--like", "zigzag_10_10", "--duration", "60", *files]
    assert main(arguments) == DONE
    assert "limits met" in capsys.readouterr().out
    table = np.genfromtxt(commands, delimiter=",", names=True)
    times, rudder = table["t_s"], table["rudder_rad"]
    assert times[-1] == 60.0
    assert np.abs(rudder).max() <= np.radians(35) * (1 + 1e-6)
    assert np.abs(np.diff(rudder) / np.diff(times)).max() <= np.radians(5) * (1 + 1e-6)
    assert "SEA TRIAL CARD" in card.read_text()
    assert "SEA TRIAL CARD" in page.read_text(encoding="utf-8")
    result = json.loads(stored.read_text())
    assert all(one["after"] < one["before"] for one in result["parameters"])
    assert all(reference["mean_gain"] > 1.0 for reference in result["references"])


def test_design_completes_a_fit(ship: Path, tmp_path: Path) -> None:
    """What a saved fit knows is the knowledge before the design."""
    saved, stored = tmp_path / "fit.json", tmp_path / "next.json"
    record = str(ship / "data" / "zigzag_10_10.csv")
    assert main(["fit", str(ship), record, "--save", str(saved)]) == DONE
    arguments = ["design", str(ship), "--after", str(saved), "--duration", "60"]
    assert main([*arguments, "--json", str(stored)]) == DONE
    from oed_sysid import Fit

    known = Fit.load(saved).std_errors
    found = {one["name"]: one["before"] for one in json.loads(stored.read_text())["parameters"]}
    assert found == pytest.approx(known, rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--criterion", "Q"], "Choose one of D, A, E"),
        (["--family", "sines"], "Choose one of levels"),
        (["--avoid", "0.1:0.2"], "add --family multisine"),
        (["--family", "multisine", "--avoid", "0.1"], "write bands as 0.1:0.2"),
        (["--effort", "huge"], "Choose one of quick"),
        (["--like", "spiral"], "no experiment 'spiral'"),
        (["--discriminate", "wind"], "no candidate 'wind'"),
        (["--reveal", "wind"], "no candidate 'wind'"),
        (["--discriminate", "a", "--reveal", "b"], "one run has one aim"),
        (["--overrides", "o.csv"], "needs the channels"),
        (["--controller", "ardupilot=o.lua"], "needs the channels"),
        (["--controller", "plc=o.txt"], "write KIND=FILE"),
        (["--overrides", "o.csv", "--servo", "fin=1"], "an input with a range: rudder"),
    ],
)
def test_design_names_what_there_is(arguments: list[str], words: str, ship: Path, capsys) -> None:
    """A wrong choice is answered with the right ones."""
    assert main(["design", str(ship), *arguments]) == BAD_INPUT
    assert words in capsys.readouterr().err


def test_limits_in_words_of_the_trade(ship: Path, tmp_path: Path, capsys) -> None:
    """A largest rudder and rate in degrees are kept; the card states them and the certainty."""
    commands, picture = tmp_path / "next.csv", tmp_path / "next.png"
    arguments = ["design", str(ship), "--duration", "60", "--max-rudder", "8", "--max-rate=3"]
    arguments += ["--max-heading", "20", "--out", str(commands), "--picture", str(picture)]
    assert main(arguments) == DONE
    card = capsys.readouterr().out
    assert "+-8 deg, at most 3 deg/s" in card
    assert "limits kept on" in card
    assert picture.stat().st_size > 10_000
    table = np.genfromtxt(commands, delimiter=",", names=True)
    assert np.abs(table["rudder_rad"]).max() == pytest.approx(np.radians(8), rel=1e-3)
    slopes = np.abs(np.diff(table["rudder_rad"]) / np.diff(table["t_s"]))
    assert slopes.max() <= np.radians(3) * (1 + 1e-6)


def test_limit_words_find_their_channels() -> None:
    """Words of the trade, names and ranges become limits of the right channel, in SI units."""
    model = load_problem("auv_diving_plane").model
    given = ["max:fin=10", "max:rate=2.5", "min:depth=80", "pitch=-20:15", "max:fin-rate=2"]
    limits, said = with_limits(model, Limits(signals={"z": (0.0, 120.0)}), given)
    assert limits.inputs["delta_s"] == pytest.approx((-np.radians(10), np.radians(10)))
    assert limits.rates["delta_s"] == pytest.approx(np.radians(2))
    assert limits.signals["z"] == (80.0, 120.0)
    assert limits.signals["theta"] == pytest.approx((-np.radians(20), np.radians(15)))
    assert said[0] == "fin is delta_s (stern plane angle)"
    for wrong, words in (
        ("max:rudder=10", "possible are .*--max-fin"),
        ("max:fin=ten", "no number"),
        ("max:depth-rate=1", "rate of 'z'"),
        ("fin", "not understood"),
        ("depth=90:80", "leaves nothing"),
    ):
        with pytest.raises(DesignError, match=words):
            with_limits(model, Limits(), [wrong])


def test_files_for_those_on_board(ship: Path, tmp_path: Path) -> None:
    """One sheet of A4, pulses of the servo, a bag and a script come from one command."""
    pytest.importorskip("rosbags")
    card, pulses, bag = tmp_path / "card.pdf", tmp_path / "o.csv", tmp_path / "bag"
    arguments = ["design", str(ship), "--duration", "60", "--max-rudder", "8", "--length", "7"]
    arguments += ["--card", str(card), "--overrides", str(pulses), "--servo", "rudder=2"]
    script = tmp_path / "run.lua"
    arguments += ["--controller", f"ardupilot={script}"]
    assert main([*arguments, "--bag", str(bag)]) == DONE
    assert "SRV_Channels" in script.read_text()
    assert card.read_bytes()[:5] == b"%PDF-"
    table = np.genfromtxt(pulses, delimiter=",", skip_header=1)
    assert table[-1, 0] == 60_000
    assert table[:, 1].min() >= 1100
    assert table[:, 1].max() <= 1900
    assert (bag / "metadata.yaml").is_file()
