"""Vehicles' own logs: every format, mapped, cut, written, checked; and torn files."""

from __future__ import annotations

import json
import os
from pathlib import Path

import log_writers as writers
import numpy as np
import pytest

from benchmarks.tables import tables
from oed_sysid import Channels, Dataset, Input, Output, load_problem, new_problem, read_csv
from oed_sysid.cli import SUSPECT, main
from oed_sysid.data import apart, formats
from oed_sysid.data.log import assemble, euler_angles, local_position
from oed_sysid.data.logs import (
    Log,
    LogMapping,
    Source,
    draft,
    import_log,
    log_of,
    open_log,
    read_mapping,
)
from oed_sysid.data.mapping import CommandCuts, Cut, parse
from oed_sysid.errors import DataError


@pytest.fixture(autouse=True)
def _here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parsers run in this process, but where a test asks for one of their own.

    The logs of the walks go through a process of each format.
    """
    if "apart_from_us" not in request.fixturenames:
        monkeypatch.setattr(formats, "read_apart", lambda place, *_: opened_here(place))


@pytest.fixture
def apart_from_us() -> None:
    """Parsers run as for a user."""


VOYAGE = writers.Voyage.short()
CHANNELS = Channels(
    (Input("rudder", "rad"),), (Output("psi", "rad", wrap=True), Output("r", "rad/s"))
)


def ulog(folder: Path) -> Path:
    """The voyage as PX4 would log it."""
    v = VOYAGE
    return writers.write_ulog(
        folder / "flight.ulg",
        {
            "vehicle_attitude": (v.t_psi, {"q": v.quaternion(v.t_psi)}),
            "vehicle_angular_velocity": (
                v.t_r,
                {"xyz": np.column_stack([0 * v.t_r, 0 * v.t_r, v.r(v.t_r)])},
            ),
            "actuator_controls_0": (v.t_rudder, {"control": v.rudder(v.t_rudder) / 0.35}),
        },
    )


ULOG_MAP = """
[inputs.rudder]
field = "actuator_controls_0.control"
factor = 0.35
unit = "rad"
[outputs.psi]
field = "vehicle_attitude.yaw"
wrap = true
[outputs.r]
field = "vehicle_angular_velocity.xyz[2]"
"""


def dataflash(folder: Path) -> Path:
    """The voyage as ArduPilot would log it: degrees, servos in microseconds."""
    v = VOYAGE
    topics = {
        "ATT": (v.t_psi, {"Yaw": np.degrees(v.psi(v.t_psi)) % 360}),
        "IMU": (v.t_r, {"GyrZ": v.r(v.t_r)}),
        "RCOU": (v.t_rudder, {"C1": 1500 + 1000 * v.rudder(v.t_rudder)}),
    }
    units = {"ATT.Yaw": "h", "IMU.GyrZ": "E", "RCOU.C1": "Y"}
    return writers.write_dataflash(folder / "00000001.BIN", topics, units)


DATAFLASH_MAP = """
[inputs.rudder]
field = "RCOU.C1"
trim = 1500
factor = 0.001
unit = "rad"
[outputs.psi]
field = "ATT.Yaw"
wrap = true
[outputs.r]
field = "IMU.GyrZ"
"""

BAG_MAP = """
[inputs.rudder]
field = "rudder.data"
unit = "rad"
[outputs.psi]
field = "imu_data.orientation.yaw_ned"
wrap = true
[outputs.r]
field = "imu_data.angular_velocity.z"
sign = -1
"""

TABLE_MAP = """
[inputs.rudder]
field = "run.rudder [deg]"
[outputs.psi]
field = "run.psi [deg]"
wrap = true
[outputs.r]
field = "run.r [deg/s]"
"""


def table() -> dict[str, np.ndarray]:
    """The voyage as a table in degrees, one row per heading."""
    t = VOYAGE.t_psi
    return {
        "t [s]": t,
        "rudder [deg]": np.degrees(VOYAGE.rudder(t)),
        "psi [deg]": np.degrees(VOYAGE.psi(t)) % 360,
        "r [deg/s]": np.degrees(VOYAGE.r(t)),
    }


def check_voyage(path: Path, mapping: str, *, digits: float, origin: float | None = None) -> None:
    """Every sample is where and what it was, and the command is what was held."""
    log = open_log(path)
    dataset = import_log(log, parse(mapping), CHANNELS).dataset
    record = dataset[0]
    # The first sample of the log is t = 0.
    first = min(VOYAGE.t_rudder[0], 0.0) if origin is None else origin
    times = record.times + first
    for name, truth in (("psi", VOYAGE.psi), ("r", VOYAGE.r)):
        values = record.output(name)
        present = np.isfinite(values)
        expected = truth(times[present])
        turns = 2 * np.pi * np.round((values[present] - expected)[0] / (2 * np.pi))
        assert present.sum() > 500
        np.testing.assert_allclose(values[present] - turns, expected, atol=digits)
    held = VOYAGE.rudder(VOYAGE.t_rudder)[
        np.searchsorted(VOYAGE.t_rudder, times + 1e-6, side="right") - 1
    ]
    if origin is not None:  # a table has the command in every row
        held = VOYAGE.rudder(times)
    np.testing.assert_allclose(record.input("rudder"), held, atol=1e-6)


@pytest.mark.usefixtures("apart_from_us")
def test_ulog_keeps_every_sample_at_its_time(tmp_path: Path) -> None:
    """Quaternions become a heading, and 10 and 25 Hz stay 10 and 25 Hz."""
    check_voyage(ulog(tmp_path), ULOG_MAP, digits=2e-6)
    log = open_log(tmp_path / "flight.ulg")
    assert log["vehicle_attitude.yaw"].rate == pytest.approx(10.0, rel=1e-3)
    assert log["vehicle_angular_velocity.xyz[2]"].unit == "rad/s"
    np.testing.assert_allclose(log["vehicle_attitude.roll"].values, 0.1, atol=1e-6)


def test_dataflash_states_its_units(tmp_path: Path) -> None:
    """Units come from the log's own messages; microseconds become radians by factor and trim."""
    path = dataflash(tmp_path)
    log = open_log(path)
    assert [log[name].unit for name in ("ATT.Yaw", "IMU.GyrZ", "RCOU.C1")] == ["deg", "rad/s", "us"]
    check_voyage(path, DATAFLASH_MAP, digits=1e-6)


@pytest.mark.parametrize("version", [1, 2])
def test_bags_of_both_versions(tmp_path: Path, version: int) -> None:
    """Header stamps are the clock; ENU and FLU become NED."""
    path = tmp_path / ("run.bag" if version == 1 else "run")
    check_voyage(writers.write_bag(path, VOYAGE, version=version), BAG_MAP, digits=1e-7)


def test_mcap_of_ros_and_json(tmp_path: Path) -> None:
    """The MCAP inside a ROS 2 bag reads as the bag does, and JSON messages are read too."""
    v = VOYAGE
    path = writers.write_mcap(
        tmp_path / "run.mcap",
        {
            "nav": (v.t_psi, {"psi": v.psi(v.t_psi)}),
            "imu": (v.t_r, {"r": v.r(v.t_r)}),
            "rudder": (v.t_rudder, {"angle": v.rudder(v.t_rudder)}),
        },
    )
    mapping = """
    [inputs.rudder]
    field = "rudder.angle"
    unit = "rad"
    [outputs.psi]
    field = "nav.psi"
    unit = "rad"
    [outputs.r]
    field = "imu.r"
    unit = "rad/s"
    """
    check_voyage(path, mapping, digits=1e-7)


def test_mcap_of_cdr(tmp_path: Path) -> None:
    """Messages of ROS 2 in a single MCAP file are decoded by the definitions that it holds."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "geometry_msgs/msg/Vector3"
    text, _ = store.generate_msgdef(kind)
    rates = [store.types[kind](0.0, 0.5, 0.01 * k) for k in range(200)]
    messages = [
        (10**9 + k * 10**8, bytes(store.serialize_cdr(one, kind))) for k, one in enumerate(rates)
    ]
    schema = kind, "ros2msg", text.encode()
    path = writers.mcap(tmp_path / "run.mcap", schema, "cdr", {"/rates": messages}, chunk_size=2000)
    series = open_log(path)["rates.z"]
    np.testing.assert_allclose(series.values, 0.01 * np.arange(200))
    assert series.rate == pytest.approx(10.0)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(path.read_bytes()[:-3000])
    log = open_log(torn)
    assert 0 < log["rates.z"].values.size < 200
    assert "breaks off" in log.notes[0]


def test_nmea_with_and_without_times(tmp_path: Path) -> None:
    """Times in front of lines are used as they are; without them positions are the clock."""
    mapping = """
    [inputs.rudder]
    constant = 0.0
    unit = "rad"
    [outputs.psi]
    field = "HEHDT.heading"
    wrap = true
    [outputs.r]
    field = "HEROT.rate_of_turn"
    """
    exact = open_log(writers.write_nmea(tmp_path / "a.nmea", VOYAGE, stamped=True))
    record = import_log(exact, parse(mapping), CHANNELS).dataset[0]
    r = record.output("r")
    present = np.isfinite(r)
    np.testing.assert_allclose(r[present], VOYAGE.r(record.times[present]), atol=2e-4)
    assert any("torn" in note for note in exact.notes)
    spread = open_log(writers.write_nmea(tmp_path / "b.nmea", VOYAGE, stamped=False))
    assert any("spread evenly" in note for note in spread.notes)
    np.testing.assert_allclose(
        spread["HEROT.rate_of_turn"].times, exact["HEROT.rate_of_turn"].times, atol=0.15
    )
    east = exact["GPRMC.east"].values
    assert east[-1] == pytest.approx(59e-4 / 60 * 111320 * np.cos(np.radians(54)), rel=4e-3)


def test_tables_of_other_programs(tmp_path: Path) -> None:
    """MATLAB, Excel, Parquet and CSV give the same record."""
    import pandas
    from openpyxl import Workbook
    from scipy.io import savemat

    columns = table()
    frame = pandas.DataFrame(columns)
    frame.to_parquet(tmp_path / "run.parquet")
    frame.to_csv(tmp_path / "run.csv", index=False)
    book = Workbook()
    book.active.title = "run"
    book.active.append(list(columns))
    for row in zip(*columns.values(), strict=True):
        book.active.append([float(value) for value in row])
    book.save(tmp_path / "run.xlsx")
    for name in ("run.parquet", "run.csv", "run.xlsx"):
        check_voyage(tmp_path / name, TABLE_MAP, digits=1e-9, origin=VOYAGE.t_psi[0])
    bare = {key.split(" ")[0]: values for key, values in columns.items()}
    savemat(tmp_path / "run.mat", {"run": bare})
    units = TABLE_MAP
    for key, unit in (("rudder", "deg"), ("psi", "deg"), ("r", "deg/s")):
        units = units.replace(f'"run.{key} [{unit}]"', f'"run.{key}"\nunit = "{unit}"')
    check_voyage(tmp_path / "run.mat", units, digits=1e-9, origin=VOYAGE.t_psi[0])


def test_the_column_of_time_can_be_named(tmp_path: Path) -> None:
    """A file without that column is read as without the name; times count from the first."""
    path = tmp_path / "run.csv"
    path.write_text("t [s],since start,yaw [deg]\n0,10,1\n1,12,2\n2,14,3\n")
    spans = {name: open_log(path, time=name).span for name in ("", "since start", "clock")}
    assert spans == {"": (0.0, 2.0), "since start": (0.0, 4.0), "clock": (0.0, 2.0)}


def test_frames_become_records_and_return() -> None:
    """A pandas frame, an xarray data set and a record hold the same numbers."""
    import pandas

    frame = pandas.DataFrame(table())
    dataset = Dataset.from_dataframe(frame, CHANNELS, name="run")
    t = VOYAGE.t_psi
    np.testing.assert_allclose(dataset["run"].output("r"), VOYAGE.r(t), atol=1e-12)
    both = dataset + dataset["run"].window(5.0, 20.0).rename("part")
    back = Dataset.from_dataframe(both.to_dataframe(), CHANNELS)
    assert back.names == ("run", "part")
    assert [r.content_hash for r in back] == [r.content_hash for r in both]
    dated = frame.drop(columns="t [s]")
    dated.index = pandas.Timestamp("2026-01-01") + pandas.to_timedelta(t, unit="s")
    with pytest.warns(UserWarning, match="1970"):
        again = Dataset.from_dataframe(dated, CHANNELS)
    np.testing.assert_allclose(again[0].times, t - t[0], atol=1e-6)
    zoned = dated.tz_localize("UTC").tz_convert("Europe/Berlin")
    zoned["r [deg/s]"] = zoned["r [deg/s]"].astype("Float64")
    zoned.iloc[3, 2] = pandas.NA
    with pytest.warns(UserWarning, match="t = 0 is 2026-01-01T00:00:00"):
        once_more = Dataset.from_dataframe(zoned, CHANNELS)[0]
    assert np.isnan(once_more.output("r")[3])
    np.testing.assert_allclose(once_more.times, again[0].times, atol=1e-6)


def test_xarray_brings_its_units() -> None:
    """Units are attributes; a second dimension is refused with what to do."""
    xarray = pytest.importorskip("xarray")
    t = VOYAGE.t_psi
    data = xarray.Dataset(
        {
            "rudder": ("time", np.degrees(VOYAGE.rudder(t)), {"units": "deg"}),
            "psi": ("time", VOYAGE.psi(t), {"units": "rad"}),
            "r": ("time", VOYAGE.r(t), {"units": "rad/s"}),
        },
        coords={"time": ("time", t, {"units": "s"})},
    )
    record = Dataset.from_xarray(data, CHANNELS)[0]
    np.testing.assert_allclose(record.input("rudder"), VOYAGE.rudder(t), atol=1e-12)
    np.testing.assert_allclose(log_of(data)["table.psi [rad]"].values, VOYAGE.psi(t))
    with pytest.raises(DataError, match="Expected one, the time"):
        Dataset.from_xarray(data.expand_dims(case=2), CHANNELS)


def test_switching_times_of_rare_commands_become_rows(tmp_path: Path) -> None:
    """A rudder that changes every ten seconds changes in the record when it did."""
    result = import_log(open_log(ulog(tmp_path)), parse(ULOG_MAP), CHANNELS)
    record = result.dataset[0]
    changes = record.times[1:][np.diff(record.input("rudder")) != 0.0]
    np.testing.assert_allclose(changes, np.arange(5.0, 60.0, 10.0), atol=1e-6)


def test_delay_trim_and_clock(tmp_path: Path) -> None:
    """A late sensor is moved, a trim taken off, and one output's times can be the rows."""
    log = open_log(ulog(tmp_path))
    mapping = parse(
        'clock = "psi"\n'
        + ULOG_MAP.replace('"vehicle_attitude.yaw"', '"vehicle_attitude.yaw"\ndelay = 0.3')
        + "trim = 0.02\n"
    )
    result = import_log(log, mapping, CHANNELS)
    record = result.dataset[0]
    plain = import_log(log, parse(ULOG_MAP), CHANNELS).dataset[0]
    moved = plain.times[np.isfinite(plain.output("psi"))] - 0.3
    own = record.times[np.isfinite(record.output("psi"))]
    np.testing.assert_allclose(own, moved[moved >= 0.0], atol=1e-9)
    assert record.n_samples == own.size + 6  # the moments at which the rudder changes
    near = np.isfinite(record.output("r"))
    times = record.times[near] - 0.5
    np.testing.assert_allclose(record.output("r")[near], VOYAGE.r(times) - 0.02, atol=6e-4)
    assert any("left out" in note for note in result.notes)


def test_cuts_by_command_and_by_mode(tmp_path: Path) -> None:
    """Manoeuvres are found where the rudder leaves its rest, and where a mode says so."""
    t = np.arange(0.0, 300.0, 0.5)
    rudder = np.zeros(t.size)
    rudder[(t >= 50) & (t < 70)] = 0.2
    rudder[(t >= 150) & (t < 165)] = -0.2
    mode = np.where((t >= 140) & (t < 200), 4.0, 1.0)
    log = assemble(
        Path("x.bin"), "test", {"a": (t, {"rudder": rudder, "r": np.cos(t), "mode": mode})}
    )
    base = {"rudder": Source("a.rudder", unit="rad")}, {"r": Source("a.r", unit="rad/s")}
    found = import_log(log, LogMapping(*base, by_commands=CommandCuts(0.05)))
    spans = [(r.times[0], r.times[-1]) for r in found.dataset]
    assert spans == [(45.0, 80.0), (145.0, 175.0)]
    # Samples in which the rudder stays away are one manoeuvre, whatever separates two.
    at_once = CommandCuts(0.05, rest=0.0, before=0.0, after=0.0)
    found = import_log(log, LogMapping(*base, by_commands=at_once))
    assert [(r.times[0], r.times[-1]) for r in found.dataset] == [(50.0, 70.0), (150.0, 165.0)]
    text = LogMapping(*base).text() + '\n[cut_while]\nfield = "a.mode"\nequals = 4\n'
    (record,) = import_log(log, parse(text)).dataset
    assert (record.times[0], record.times[-1]) == (140.0, 200.0)
    with pytest.raises(DataError, match="finds no manoeuvre"):
        import_log(log, LogMapping(*base, by_commands=CommandCuts(0.9)))
    with pytest.raises(DataError, match="the log lasts from"):
        import_log(log, LogMapping(*base, cuts=(Cut("late", 900.0, 950.0),)))


def test_thinning_keeps_samples_as_they_were() -> None:
    """One sample per interval, none changed."""
    t = np.arange(0.0, 20.0, 0.01)
    log = assemble(Path("x.bin"), "test", {"a": (t, {"r": np.sin(t)})})
    mapping = LogMapping({}, {"r": Source("a.r", unit="rad/s")}, sample_time=0.1)
    record = import_log(log, mapping).dataset[0]
    assert record.n_samples == 201
    np.testing.assert_allclose(record.output("r"), np.sin(record.times), atol=1e-12)


def test_linear_inputs_are_interpolated_and_said() -> None:
    """A measured angle is interpolated between its own samples, with a note."""
    t = np.arange(0.0, 20.0, 0.1)
    slow = np.arange(0.0, 20.5, 1.0)
    log = assemble(
        Path("x.bin"), "test", {"a": (t, {"r": np.sin(t)}), "b": (slow, {"angle": 0.01 * slow})}
    )
    channels = Channels((Input("d", "rad", interpolation="linear"),), (Output("r", "rad/s"),))
    mapping = LogMapping({"d": Source("b.angle", unit="rad")}, {"r": Source("a.r", unit="rad/s")})
    result = import_log(log, mapping, channels)
    np.testing.assert_allclose(result.dataset[0].input("d"), 0.01 * t, atol=1e-12)
    assert any("interpolated linearly" in note for note in result.notes)


@pytest.mark.parametrize(("text", "words"), tables(__file__)["faulty"].items())
def test_faulty_mappings_are_refused_in_words(text: str, words: str) -> None:
    """Every fault of a mapping is said where it stands."""
    with pytest.raises(DataError, match=words):
        parse(text)


def test_wrong_fields_and_units_are_refused() -> None:
    """A field that is not there, a unit that does not fit, a clock that goes back."""
    t = np.arange(0.0, 20.0, 0.1)
    log = assemble(Path("x.bin"), "test", {"gyro": (t, {"z": t})})
    outputs = Channels((), (Output("r", "rad/s"),))
    for source, words in (
        (Source("gyro.y"), "has no field"),
        (Source("gyro.z"), "has no unit"),
        (Source("gyro.z", unit="m/s"), r"channel needs \[rad/s\]"),
    ):
        with pytest.raises(DataError, match=words):
            import_log(log, LogMapping({}, {"r": source}), outputs)
    back = np.concatenate([t, t[:50]])
    log = assemble(Path("x.bin"), "test", {"gyro": (back, {"z": back})})
    with pytest.raises(DataError, match=r"goes back at 19\.9"):
        import_log(log, LogMapping({}, {"r": Source("gyro.z", unit="rad/s")}), outputs)
    jumps = assemble(Path("x.bin"), "test", {"c": (t, {"psi": (3.0 + 0.2 * t) % (2 * np.pi)})})
    with pytest.raises(DataError, match=r"add  wrap = true  to \[outputs.psi\]"):
        import_log(jumps, LogMapping({}, {"psi": Source("c.psi", unit="rad")}))
    with pytest.raises(DataError, match=r"no \[inputs.rudder\]"):
        import_log(log, LogMapping({}, {"r": Source("gyro.z", unit="rad/s")}), CHANNELS)


def test_torn_logs_say_so(tmp_path: Path) -> None:
    """Every format cut in the middle gives what stands before, or an error in words."""
    whole = {
        "torn.ulg": ulog(tmp_path),
        "torn.BIN": dataflash(tmp_path),
        "torn.bag": writers.write_bag(tmp_path / "run.bag", VOYAGE, version=1),
    }
    for name, source in whole.items():
        content = source.read_bytes()
        for share in (0.0, 0.001, 0.02, 0.5, 0.97):
            torn = tmp_path / name
            torn.write_bytes(content[: int(share * len(content))])
            assert readable(torn)
            if share > 0.1 and name.endswith("bag"):  # a bag has its index at the end
                with pytest.raises(DataError, match=r"torn\.bag cannot be read.*rosbag reindex"):
                    opened_here(torn)
            elif share > 0.1:
                assert any("break" in note for note in opened_here(torn).notes)
    assert not opened_here(whole["torn.ulg"]).notes
    rng = np.random.default_rng(1)
    for name, source in whole.items():
        damaged = bytearray(source.read_bytes())
        for at in rng.integers(20, len(damaged), 40):
            damaged[at] = rng.integers(0, 256)
        (tmp_path / name).write_bytes(bytes(damaged))
        assert readable(tmp_path / name)


def opened_here(path: Path) -> Log:
    """The log as its child process reads it, without the process."""
    form = formats.format_of(path)
    return apart.guarded(form.reader, path, form.words, form.advice)


@pytest.mark.usefixtures("apart_from_us")
@pytest.mark.parametrize(
    ("child", "words"),
    [
        ("import os; os.abort()", r"crashed \(SIGABRT\)"),
        ("import os; os._exit(3)", "ended with 3"),
        ("raise ValueError('torn')", r"ended with 1 \(ValueError: torn\)"),
        ("serve(lambda path: forever())", "did not end after 2 s"),
        ("serve(lambda path: bytearray(2**45))", "more memory than a log"),
        ("serve(lambda path: [1][2])", r"\(list index out of range\)"),
        ("serve(lambda path: bytes([65, 255]).decode())", "at byte 1"),
    ],
)
def test_whatever_a_parser_does_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, child: str, words: str
) -> None:
    """Crash, endless loop, endless memory and any exception of a parser name the file."""
    prelude = (
        "import sys, json; sys.path[:] = json.loads(sys.argv[1])\n"
        "from pathlib import Path; from oed_sysid.data import apart\n"
        "def forever():\n    while True: pass\n"
        "def serve(read):\n"
        "    place, target = map(Path, sys.argv[2:])\n"
        "    apart.serve(lambda p: apart.guarded(read, p, 'a log', 'Help.'), place, target)\n"
    )
    monkeypatch.setattr(apart, "_CHILD", prelude * child.startswith("serve") + child)
    monkeypatch.setattr(apart, "SECONDS", 2.0)
    monkeypatch.setattr(apart, "PATIENCE", 60.0)  # the limit is of computing
    file = tmp_path / "run.ulg"
    file.write_bytes(b"ULog")
    with pytest.raises(DataError, match=words) as caught:
        apart.read_apart(file, "a PX4 log", "Help.")
    assert "run.ulg cannot be read" in str(caught.value)
    assert "Help." in str(caught.value)


def test_log_of_too_many_numbers_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log that would fill the memory of the caller is refused with its size."""
    monkeypatch.setattr(apart, "MOST_NUMBERS", 100)
    with pytest.raises(DataError, match=r"flight\.ulg holds .* numbers"):
        opened_here(ulog(tmp_path))


def readable(path: Path) -> bool:
    """Whether a damaged log gives fields, or an error of the package in a sentence."""
    try:
        return len(opened_here(path).names) > 0
    except DataError as error:
        return len(str(error)) > 30


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.ulg", b"", "is empty"),
        ("a.ulg", b"hello", "does not begin like one"),
        ("a.xyz", b"hello", "no format that is known"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "cannot be read as a MATLAB"),
        ("a.mat", b"\x89HDF\r\n\x1a\n" + bytes(200), "MATLAB"),
        ("a.xlsx", b"PK\x03\x04" + bytes(200), "cannot be read as an Excel"),
        ("a.parquet", b"PAR1" + bytes(200), "cannot be read as a Parquet"),
        ("a.mcap", b"\x89MCAP0\r\n" + bytes(200), "MCAP"),
        ("a.bag", b"#ROSBAG V2.0\n" + bytes(200), "cannot be read as a ROS bag"),
        ("a.nmea", b"$GPRMC,garbage*00\n", "right checksum"),
    ],
)
def test_hostile_files_are_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    """What is no log says so, and never with a traceback from a library."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=words):
        opened_here(tmp_path / name)


def test_missing_library_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without pyulog the message says what to install."""
    import sys

    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(DataError, match=r'pip install "oed_sysid\[logs\]"'):
        open_log(ulog(tmp_path))


def test_two_commands_from_log_to_checked_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """--list, then --map: for a ULog, a DataFlash file and a bag, against a problem and without."""
    monkeypatch.chdir(tmp_path)
    logs = {
        str(ulog(tmp_path).name): ULOG_MAP,
        str(dataflash(tmp_path).name): DATAFLASH_MAP,
        str(writers.write_bag(tmp_path / "run", VOYAGE, version=2).name): BAG_MAP,
    }
    for log, text in logs.items():
        Path("map.toml").write_text(text)
        assert main(["import", log, "--list", "--json", "fields.json"]) == 0
        fields = json.loads(Path("fields.json").read_text())["fields"]
        assert len(fields) >= 3
        assert main(["import", log, "--map", "map.toml", "--out", "data"]) == 0
        written = Path("data") / f"{Path(log).stem}.csv"
        record = read_csv(written, CHANNELS)[0]
        assert np.isfinite(record.output("r")).sum() == VOYAGE.t_r.size
    capsys.readouterr()


def test_records_of_a_problem_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """A heading with the wrong sign is found on the way in and ends with exit code 1."""
    monkeypatch.chdir(tmp_path)
    problem = new_problem(tmp_path / "boat")
    text = (Path(problem) / "problem.py").read_text()
    assert '"psi"' in text
    log = str(ulog(tmp_path))
    good = 'problem = "boat"\n' + ULOG_MAP
    Path("good.toml").write_text(good)
    Path("bad.toml").write_text(good.replace('yaw"', 'yaw"\nsign = -1'))
    assert main(["import", log, "--map", "good.toml", "--out", "good"]) == 0
    assert main(["import", log, "--map", "bad.toml", "--out", "bad", "--json", "bad.json"]) == 4
    findings = json.loads(Path("bad.json").read_text())["check"]
    assert "psi" in json.dumps(findings)
    assert main(["import", log, "--problem", "boat", "--draft", "draft.toml"]) == 0
    assert read_mapping("draft.toml").outputs["psi"].field == "vehicle_attitude.yaw"
    assert main(["import", log, "--draft", "draft.toml"]) == 2
    assert main(["import", log, "--map", "good.toml", "--out", "good.csv"]) == 2
    assert "Give a folder" in capsys.readouterr().err


def test_several_logs_share_the_mapping_of_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """What the first is told to hold the others are read as; one without a field is named."""
    monkeypatch.chdir(tmp_path)
    problem, times = str(new_problem(tmp_path / "boat")), np.arange(0.0, 60.0, 0.5)
    for name, slow in (("one", 0.1), ("two", 0.07), ("bad", 0.13)):
        heading = 30.0 * np.sin(slow * times)
        rudder = 20.0 * np.sin(2.0 * slow * times)
        rate = "yaw [deg/s]" if name == "bad" else "YawRate (deg/s)"
        table = np.column_stack([times, rudder, heading, np.gradient(heading, times)])
        header = f"time_s,rudder_angle_deg,Heading (deg),{rate}"
        np.savetxt(f"{name}.csv", table, delimiter=",", header=header, comments="")
    asked = ["--problem", problem, "--json", "out.json", "--out"]
    assert main(["import", "one.csv", "two.csv", *asked, "data"]) in (0, SUSPECT)
    told = json.loads(Path("out.json").read_text())
    assert told["logs"] == ["one.csv", "two.csv"]
    records = read_csv(tmp_path / "data", load_problem(problem).model.channels)
    assert [record.name for record in records] == ["one", "two"]
    for record, slow in zip(records, (0.1, 0.07), strict=True):
        expected = np.radians(30.0 * np.sin(slow * times))
        np.testing.assert_allclose(record.output("psi"), expected, atol=1e-9)
    capsys.readouterr()
    assert main(["import", "one.csv", "bad.csv", *asked, "none"]) == 2
    said = capsys.readouterr().err
    assert "bad.csv" in said
    assert "YawRate" in said
    assert not Path("none").exists()


def test_draft_maps_what_has_a_name(tmp_path: Path) -> None:
    """Known fields are guessed, the rest is left to the user."""
    made = draft(open_log(ulog(tmp_path)), CHANNELS, problem="boat")
    assert made.outputs["psi"].field == "vehicle_attitude.yaw"
    assert made.outputs["r"].field == "vehicle_angular_velocity.xyz[2]"
    assert "rudder" not in made.inputs  # an input is never made up
    made.write(tmp_path / "map.toml")
    assert read_mapping(tmp_path / "map.toml") == made


@pytest.mark.skipif(
    not os.environ.get("OED_SYSID_DATA"), reason="needs measured data, OED_SYSID_DATA"
)
def test_a_real_log_of_px4(tmp_path: Path) -> None:
    """A flight log: attitude and gyro agree but for a bias, and the drop-out is where it was."""
    path = Path(os.environ["OED_SYSID_DATA"]) / "log_formats" / "sample_log_small.ulg"
    if not path.exists():
        pytest.skip(f"{path.name} is not there")
    log = open_log(path)
    yaw, rate = log["vehicle_attitude.yaw"], log["vehicle_angular_velocity.xyz[2]"]
    assert (yaw.values.size, rate.values.size) == (1298, 1812)
    assert np.diff(yaw.times).max() == pytest.approx(0.1613, abs=1e-4)  # the logger's drop-out
    steps = np.diff(rate.times) * (rate.values[1:] + rate.values[:-1]) / 2
    integral = np.interp(yaw.times, rate.times, np.concatenate([[0.0], np.cumsum(steps)]))
    # The gyro has a bias that the filter on board is still learning; the rest agrees.
    away = yaw.values - integral
    bend = away - np.polyval(np.polyfit(yaw.times, away, 2), yaw.times)
    assert np.std(bend) < 0.1 * np.std(yaw.values)


def test_quaternions_and_positions_by_hand() -> None:
    """Euler angles of composed rotations, and a degree of longitude at 60 degrees north."""
    angles = np.array([[0.3, -0.4, 2.5], [-1.2, 0.9, -3.0]])
    found = np.column_stack(euler_angles(writers.quaternion(*angles.T)))
    np.testing.assert_allclose(found, angles, atol=1e-12)
    _, east = local_position(np.array([60.0, 60.0]), np.array([10.0, 11.0]))
    assert east[1] == pytest.approx(55800.0, rel=1e-4)  # standard tables of WGS 84


def test_matlab_file_that_breaks_off_is_refused(tmp_path: Path) -> None:
    """A file cut anywhere is refused in words, whatever its parser makes of it."""
    from scipy.io import savemat

    t = np.arange(20.0)
    for compressed in (False, True):
        savemat(
            tmp_path / "run.mat", {"t": t, "x": np.sin(t), "n": "abc"}, do_compression=compressed
        )
        content = (tmp_path / "run.mat").read_bytes()
        assert open_log(tmp_path / "run.mat").names == ("run.x",)
        torn = tmp_path / "torn.mat"
        for length in np.linspace(129, len(content) - 1, 5).astype(int):
            torn.write_bytes(content[:length])
            with pytest.raises(DataError, match=r"torn\.mat"):
                opened_here(torn)


def test_engines_of_nmea_are_apart(tmp_path: Path) -> None:
    """Sentences of two engines and of a rudder are three commands, each in its unit."""
    lines = []
    for k in range(60):
        texts = (f"HEHDT,{100 + k % 20:.1f},T", f"IIRSA,{k % 7}.0,A,,",
                 f"IIRPM,S,1,{200 + k % 5}.0,0,A", f"IIRPM,S,2,{300 + k % 5}.0,0,A")  # fmt: skip
        lines += [f"{k}.0 {writers.sentence(text)}" for text in texts]
    path = tmp_path / "ferry.nmea"
    path.write_text("\n".join(lines))
    made = draft(open_log(path))
    assert made is not None
    record = import_log(open_log(path), made).dataset[0]
    assert record.input("rudder").max() == pytest.approx(np.radians(6.0))
    assert record.input("IIRPM_S1_speed").max() == pytest.approx(204.0 / 60.0)
    assert record.input("IIRPM_S2_speed").max() == pytest.approx(304.0 / 60.0)
