"""Estimation while the run goes on: lines of a file, of a port, sentences and messages."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from commands import told
from log_writers import sentence
from plain_pages import plain_pages  # noqa: F401

from oed_sysid import Channels, Input, Output, Record, load_problem, read_csv, simulate
from oed_sysid.data.live import Place, samples
from oed_sysid.errors import DataError

HEADING = Channels((Input("d", "rad"),), (Output("psi", "rad"), Output("r", "rad/s")))


@cache
def zigzag() -> Record:
    """A shipped ship's zigzag with noise."""
    ship = load_problem("online_ship")
    return simulate(ship.model, ship.experiment("zigzag_10_10"), rng=np.random.default_rng(0))


def lines(record: Record) -> Iterator[str]:
    """The record as CSV, angles in degrees."""
    channels = (*record.channels.inputs, *record.channels.outputs)
    angles = [one.unit == "rad" for one in channels]
    units = ["deg" if angle else one.unit for one, angle in zip(channels, angles, strict=True)]
    yield ",".join(["t [s]", *(f"{c.name} [{u}]" for c, u in zip(channels, units, strict=True))])
    for t, row in zip(record.times, np.hstack([record.inputs, record.outputs]), strict=True):
        shown = np.where(angles, np.degrees(row), row)
        yield ",".join([f"{t:g}", *(f"{value:.9g}" for value in shown)])


def test_a_log_is_watched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command ends at estimates near the truth, with a page and plain data."""
    log, page = tmp_path / "run.csv", tmp_path / "live.html"
    log.write_text("\n".join(lines(zigzag())) + "\n")
    line = ["watch", "online_ship", "--source", log, "--silence", "0.2", "--html", page]
    data = told(tmp_path, line)
    truth = load_problem("online_ship").model.values
    assert data["samples"] == len(zigzag().times)
    near = [
        abs(data["values"][n] / truth[n] - 1) < 4 * e for n, e in data["relative_errors"].items()
    ]
    assert np.mean(near) > 0.8
    assert "refresh" not in page.read_text()
    assert len(capsys.readouterr().err.splitlines()) > 10


def test_a_port_gives_what_the_file_gives() -> None:
    """Lines over UDP on the loopback are the samples of the file."""
    record = zigzag()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    ready = threading.Event()

    def send() -> None:
        ready.wait()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for line in list(lines(record))[:200]:
                out.sendto(line.encode(), ("127.0.0.1", port))
                time.sleep(2e-4)

    thread = threading.Thread(target=send)
    thread.start()
    threading.Timer(0.3, ready.set).start()
    found = list(samples(f"udp://127.0.0.1:{port}", record.channels, silence=1.0))
    thread.join()
    assert len(found) > 190
    names = record.channels.output_names
    for t, sample in found[:50]:
        row = int(np.argmin(np.abs(record.times - t)))
        seen = [sample[name] for name in names]
        assert seen == pytest.approx(record.outputs[row], rel=1e-6, abs=1e-9)


def test_lines_are_read_as_the_file_is(tmp_path: Path) -> None:
    """Other names and signs of a log mean the same sample by sample as in a whole file."""
    rudder = Input("d", "rad", column="rudder [deg]", sign=-1.0)
    channels = Channels((rudder,), (Output("r", "rad/s", column="rate"),))
    log = tmp_path / "log.csv"
    rows = [f"{500 * k};{k};{2 * k};0" for k in range(8)]
    log.write_text("\n".join(["t [ms];rudder [deg];rate [deg/s];mode", *rows]) + "\n")
    found = list(samples(str(log), channels, silence=0.1))
    record = read_csv(log, channels)[0]
    assert [t for t, _ in found] == pytest.approx(record.times)
    assert [one["d"] for _, one in found] == pytest.approx(record.input("d"))
    assert [one["r"] for _, one in found] == pytest.approx(record.output("r"))
    assert found[-1][1]["d"] == pytest.approx(-math.radians(7.0))


def test_sentences_are_gathered(tmp_path: Path) -> None:
    """Heading, rate of turn and rudder of NMEA 0183, wrapped at north, at a period."""
    pytest.importorskip("pynmea2")
    log = tmp_path / "nmea.txt"
    with log.open("w") as file:
        for k in range(100):
            heading = (350.0 + 0.5 * k) % 360
            for text in (
                f"HEHDT,{heading:.1f},T", "TIROT,30.0,A", f"AGRSA,{5.0:.1f},A,,V",
            ):  # fmt: skip
                file.write(f"{0.5 * k:.2f} {sentence(text)}\n")
    places = {
        "psi": Place.of("HDT.heading:deg"),
        "r": Place.of("ROT.rate_of_turn:deg/min"),
        "d": Place.of("RSA.rsa_starboard:deg"),
    }
    found = list(samples(str(log), HEADING, places=places, period=1.0, silence=0.1))
    times, headings = zip(*((t, one["psi"]) for t, one in found), strict=True)
    assert np.diff(times) == pytest.approx(1.0)
    assert np.diff(headings) == pytest.approx(math.radians(1.0), abs=1e-9)
    assert found[0][1]["r"] == pytest.approx(math.radians(0.5))
    assert found[0][1]["d"] == pytest.approx(math.radians(5.0))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("t [s],psi [deg]\n0,1\n", "no column 'd'"),
        ("", "Nothing came"),
        ("$HEHDT,10.0,T*2F\n", "--map"),
    ],
)
def test_what_cannot_be_read_is_said(text: str, match: str, tmp_path: Path) -> None:
    """Messages name what is missing."""
    log = tmp_path / "log.csv"
    log.write_text(text)
    with pytest.raises(DataError, match=match):
        list(samples(str(log), HEADING, silence=0.1))


@pytest.mark.parametrize("source", ["udp://nowhere", "absent.csv"])
def test_a_source_that_is_none(source: str) -> None:
    """An address or a file that is not there is named."""
    with pytest.raises(DataError, match=r"nowhere|absent"):
        list(samples(source, HEADING, silence=0.1))


def test_torn_lines_are_left_out(tmp_path: Path) -> None:
    """A line without all cells, or with words, is no sample; an empty cell is missing."""
    log = tmp_path / "log.csv"
    log.write_text("t [s],d [deg],psi [deg],r [deg/s]\n0,1,2,3\n1,1\n2,1,x,3\n3,1,,3\n4,1,2")
    found = list(samples(str(log), HEADING, silence=0.1))
    assert [t for t, _ in found] == [0.0, 3.0]
    assert math.isnan(found[1][1]["psi"])
