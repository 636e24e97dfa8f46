"""Logs of strangers: what fields are is read from their numbers, and asked where in doubt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import told
from log_writers import mcap
from marks import slow

from benchmarks import door
from oed_sysid import Channels, Input, Output, load_problem, new_problem, open_log
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.data.log import assemble, meaning, side_of
from oed_sysid.data.logs import draft, import_log
from oed_sysid.data.mapping import parse
from oed_sysid.data.recognise import called, recognise
from oed_sysid.errors import DataError, ProblemError, UnitWarning

T = np.arange(0.0, 600.0, 0.5)


def circle(sign: int = 1) -> dict[str, np.ndarray]:
    """A vessel that turns both ways, in closed form of heading and rate; positions integrated."""
    psi = 1.0 + 2.5 * np.sin(0.02 * T)
    r = 0.05 * np.cos(0.02 * T)
    u = 3.0 + 0.5 * np.sin(0.013 * T)
    way = np.cumsum(u * np.exp(1j * psi)) * 0.5
    return {"psi": sign * psi, "r": sign * r, "u": u, "x": way.real, "y": sign * way.imag}


def log_of(**columns: np.ndarray):
    """A log of columns without units."""
    noise = np.random.default_rng(3)
    noisy = {n: v + 1e-3 * np.std(v) * noise.standard_normal(v.size) for n, v in columns.items()}
    return assemble(Path("a.csv"), "test", {"a": (T, noisy)})


def test_meaningless_names_are_told_by_kinematics() -> None:
    """Units are ratios of slopes; a compass, its rate, speed and positions are found."""
    s = circle()
    log = log_of(
        c1=s["x"], c2=s["u"] / 0.514444, c3=np.degrees(s["r"]) * 60.0, c4=np.degrees(s["psi"]),
        c5=s["y"],
    )  # fmt: skip
    found = recognise(log)
    read = {one.role: (one.field, one.unit) for one in found.guesses}
    assert read["psi"] == ("a.c4", "deg")
    assert read["r"] == ("a.c3", "deg/min")
    assert read["u"] == ("a.c2", "kn")
    assert {read["x"][0], read["y"][0]} == {"a.c1", "a.c5"}
    # North-east-down or east-north-up: the numbers do not tell, so it is asked.
    assert "sign" in found["psi"].doubts


@pytest.mark.parametrize("flip", [1, -1])
def test_names_of_axes_settle_which_way_a_heading_counts(flip: int) -> None:
    """With north and east named, a yaw angle that counts backwards is reversed unasked."""
    s = circle()
    log = log_of(nord=s["x"], ost=s["y"], fahrt=s["u"], gierwinkel=flip * s["psi"], gierrate=s["r"])
    found = recognise(log)
    assert (found["psi"].sign, found["r"].sign) == (flip, 1)
    assert found["psi"].doubts == found["r"].doubts == ()
    record = import_log(log, draft(log)).dataset[0]
    np.testing.assert_allclose(record.output("psi"), s["psi"], atol=0.02)


def test_heading_from_east_becomes_one_from_north() -> None:
    """East-north-up: the heading is reversed and its zero moved by a right angle."""
    s = circle()
    log = log_of(est=s["y"], nord=s["x"], lacet=np.degrees(np.pi / 2 - s["psi"]), vitesse=s["u"])
    record = import_log(log, draft(log)).dataset[0]
    np.testing.assert_allclose(record.output("psi"), s["psi"], atol=0.02)


@pytest.mark.parametrize("count", [2, *slow(10)])
def test_foreign_logs_are_read_or_asked(tmp_path: Path, count: int) -> None:
    """Of logs of the examination with seeds of their own little is wrong, most is right."""
    verdicts = []
    for number in range(count):
        verdicts += door.examined(tmp_path, np.random.default_rng([5, number]), number)
    right, wrong = (sum(v == what for _, v, _ in verdicts) for what in ("right", "wrong"))
    assert right > 0.75 * len(verdicts)
    assert wrong < 0.03 * len(verdicts)


@pytest.mark.parametrize(
    ("name", "role"),
    [("Gierrate", "r"), ("vitesse de lacet", "r"), ("ángulo de timón", "rudder"), ("prua", "psi"),
     ("Quergeschwindigkeit", "v"), ("speed athwart", "v"), ("diepte", "z"), ("Drehzahl", "rpm"),
     ("ch7", ""), ("rollRate", "p"), ("velocidad", "u")],
)  # fmt: skip
def test_words_of_several_languages(name: str, role: str) -> None:
    """Compound names mean what their parts say."""
    assert meaning(f"log.{name}")[0] == role


@pytest.mark.parametrize("how", door.CLOCKS)
def test_clocks_without_a_known_name(tmp_path: Path, how: str) -> None:
    """Seconds, milliseconds, minutes, clocks and dates give the same times, whatever their name."""
    s = circle()
    stamps = door.stamps(T, how, np.random.default_rng(0))
    rows = [f"{a};{b:.6f};{c:.8f}" for a, b, c in zip(stamps, s["psi"], s["r"], strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["Messpunkt;Kurs;Gierrate [rad/s]", *rows]))
    log = open_log(path)
    record = import_log(log, draft(log)).dataset[0]
    np.testing.assert_allclose(record.times - record.times[0], T, atol=1e-3)
    text = draft(log).text()
    assert parse(text).text() == text


def test_times_of_another_field() -> None:
    """A mapping may name the field that holds the times, and its unit."""
    log = assemble(Path("a"), "", {"a": (T, {"own": 2000.0 * T, "Kurs [deg]": T})})
    mapping = parse(
        'time = "a.own"\ntime_unit = "ms"\n[outputs.psi]\nfield = "a.Kurs [deg]"\nunit = "deg"'
    )
    record = import_log(log, mapping).dataset[0]
    np.testing.assert_allclose(record.times, 2.0 * T)


def test_parquet_with_an_index_of_dates(tmp_path: Path) -> None:
    """The index of a frame is its clock, with a name or none."""
    pandas = pytest.importorskip("pandas")
    index = pandas.Timestamp("2025-01-01", tz="UTC") + pandas.to_timedelta(T, "s")
    frame = pandas.DataFrame({"psi [deg]": T}, index=pandas.DatetimeIndex(index))
    for name in (None, "logged"):
        frame.index.name = name
        frame.to_parquet(tmp_path / "run.parquet")
        log = open_log(tmp_path / "run.parquet")
        np.testing.assert_allclose(log["run.psi [deg]"].times, T, atol=1e-6)


def test_matlab_73(tmp_path: Path) -> None:
    """Structures of a file of version 7.3 are topics; its matrices are turned back."""
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("run")
        for name, values in (("t", T), ("psi", np.sin(T))):
            group.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = b"double"
        group.create_dataset("pq", data=np.stack([T, 2 * T])).attrs["MATLAB_class"] = b"double"
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(head + path.read_bytes()[128:])
    log = open_log(path)
    np.testing.assert_array_equal(log["run.psi"].values, np.sin(T))
    np.testing.assert_array_equal(log["run.pq[1]"].values, 2 * T)


def test_mcap_of_protobuf(tmp_path: Path) -> None:
    """Messages are decoded by the descriptors in the file, nested ones and lists too."""
    proto = pytest.importorskip("google.protobuf.descriptor_pb2")
    from google.protobuf import descriptor_pool, message_factory

    pytest.importorskip("mcap.writer")
    file = proto.FileDescriptorProto(name="a.proto", package="my", syntax="proto3")
    vector = file.message_type.add(name="Vector")
    for number, name in enumerate("xyz", start=1):
        vector.field.add(name=name, number=number, type=1, label=1)
    imu = file.message_type.add(name="Imu")
    imu.field.add(name="rate", number=1, type=11, type_name=".my.Vector", label=1)
    imu.field.add(name="q", number=2, type=1, label=3)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName("my.Imu"))
    messages = []
    for time in T[:50]:
        message = made(q=[1.0, 0.0, 0.0, 0.0])
        message.rate.z = 0.1 * time
        messages.append((round(1e9 * time) + 10**18, message.SerializeToString()))
    schema = "my.Imu", "protobuf", proto.FileDescriptorSet(file=[file]).SerializeToString()
    log = open_log(mcap(tmp_path / "run.mcap", schema, "protobuf", {"/imu": messages}))
    np.testing.assert_allclose(log["imu.rate.z"].values, 0.1 * T[:50])
    np.testing.assert_allclose(log["imu.rate.z"].times, T[:50], atol=1e-6)


def test_first_model_of_a_heading_is_of_second_order(tmp_path: Path) -> None:
    """A foreign log of a heading and a rudder gives a rate that is not measured, and its slopes."""
    rudder = 0.3 * np.sign(np.sin(0.03 * T))
    gain, lag = 0.1, 8.0
    r, psi = np.zeros(T.size), np.zeros(T.size)
    for k in range(T.size - 1):  # Nomoto's first-order model of the yaw rate, by Euler's method
        r[k + 1] = r[k] + 0.5 * (gain * rudder[k] - r[k]) / lag
        psi[k + 1] = psi[k] + 0.5 * r[k]
    rows = [
        f"{t:.1f};{h:.5f};{d:.4f}".replace(".", ",")
        for t, h, d in zip(T, np.degrees(psi) % 360, np.degrees(rudder), strict=True)
    ]
    log = tmp_path / "fahrt.csv"
    log.write_text("\n".join(["Zeit;Kurs;Ruderlage", *rows]))
    problem = load_problem(new_problem(tmp_path / "schiff", log=log))
    model = problem.model
    assert (model.state_names, model.output_names) == (("psi", "r"), ("psi",))
    values = {p.name: p.value for p in model.parameters}
    assert values["r_rudder"] == pytest.approx(gain / lag, rel=0.2)
    assert values["r_r"] == pytest.approx(-1 / lag, rel=0.2)
    (record,) = problem.data()
    np.testing.assert_allclose(record.output("psi"), psi, atol=1e-4)


def test_import_says_what_it_read_and_keeps_the_mapping(tmp_path: Path) -> None:
    """One command from a foreign log to records; its mapping gives the same records again."""
    s = circle()
    rows = [f"{a:.2f},{b:.6f},{c:.8f}" for a, b, c in zip(T, s["psi"], s["r"], strict=True)]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["temps,cap,vitesse de lacet", *rows]))
    content = told(tmp_path, ["import", log])
    assert content["check"]["relations"]
    assert not content["check"]["findings"]
    guessed = {one["role"]: one for one in content["guesses"]}
    assert (guessed["psi"]["unit"], guessed["r"]["unit"]) == ("rad", "rad/s")
    for name, more in (("first", []), ("again", ["--map", str(tmp_path / "first/mapping.toml")])):
        assert main(["import", str(log), "--out", str(tmp_path / name), *more]) == DONE
    first, again = (tmp_path / name / "log.csv" for name in ("first", "again"))
    assert first.read_text() == again.read_text()
    log.rename(tmp_path / "next.csv")
    more = ["--map", str(tmp_path / "first/mapping.toml"), "--out", str(tmp_path / "next")]
    assert main(["import", str(tmp_path / "next.csv"), *more]) == DONE
    assert (tmp_path / "next/next.csv").read_text() == first.read_text()


def test_every_field_of_a_ships_own_log_is_told(tmp_path: Path, capsys) -> None:
    """Cells that are empty are no samples; a gyro in degrees, held revolutions and a side count."""
    s, slow_rows = circle(), np.arange(T.size) % 4 == 0
    columns = {
        "Kreisel [°]": np.degrees(s["psi"]) % 360.0,
        "Drehrate [°/min]": np.degrees(s["r"]) * 60.0,
        "Ruderlage Bb+ [°]": 9.0 * np.sign(np.sin(0.02 * T)),
        "Wellendrehzahl [1/min]": np.where(slow_rows, 180.0, np.nan),
        "Fahrt [kn]": np.where(slow_rows, s["u"] / 0.514444, np.nan),
        "Temperatur": np.random.default_rng(4).normal(20.0, 3.0, T.size),
    }
    cells = np.column_stack([T, *columns.values()])
    lines = [";".join("" if np.isnan(x) else f"{x:.3f}" for x in row) for row in cells]
    file = tmp_path / "ferry.csv"
    file.write_text("\n".join([";".join(["Zeit [s]", *columns]), *lines]), encoding="utf-8")
    log = open_log(file)
    found = recognise(log)
    assert (found["psi"].field, found["rudder"].sign) == ("ferry.Kreisel [°]", -1)
    assert (found["rpm"].unit, found["rpm"].doubts) == ("1/min", ())
    rows = found.rows(log)
    assert {row["field"] for row in rows} == set(log.names)
    assert [row["as read"] for row in rows if row["field"] == "ferry.Temperatur"] == ["not read"]
    counts = {row[0]: row[1:3] for row in log.rows()}
    assert counts["ferry.Fahrt [kn]"] == ("300", "0.5 Hz")
    assert counts["ferry.Kreisel [°]"] == ("1200", "2 Hz")


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("Rudder (+ = port)", -1), ("helm port+ [deg]", -1), ("barre tribord +", 1),
        ("Ruder Bb- [°]", 1), ("port rudder", 0), ("log.port-side", 0), ("timon + babor", -1),
    ],
)  # fmt: skip
def test_a_name_may_say_to_which_side_it_counts(name: str, side: int) -> None:
    """A plus or a minus beside a side; a side alone is a place."""
    assert side_of(name) == side


def test_a_rig_of_which_no_field_is_known(tmp_path: Path) -> None:
    """Nothing is written and that is an error; a starter finds its clock as an import does."""
    times = 0.5 * np.arange(40)
    columns = np.column_stack([times, np.sign(np.sin(times)), 10.0 + np.sin(times)])
    log = tmp_path / "rig.csv"
    np.savetxt(log, columns, delimiter=",", header="Zeit [s],Pumpe [V],Pegel [cm]", comments="")
    assert main(["import", str(log), "--out", str(tmp_path / "out")]) == BAD_INPUT
    assert not (tmp_path / "out").exists()
    folder = new_problem(tmp_path / "rig", log=log, inputs=("Pumpe",))
    assert set(load_problem(folder).model.input_names) == {"Pumpe"}


def test_setpoints_and_integrators_are_no_measurements() -> None:
    """What PX4 defines stands above words, of many fields too; what was wanted is none."""
    s, noise = circle(), np.random.default_rng(5)
    topics = {
        "rate_ctrl_status": (T, {"yawspeed_integ": 0.1 * s["r"]}),
        "vehicle_attitude_setpoint": (T, {"pitch_body": 0.1 * s["r"], "yaw_body": s["psi"]}),
        "vehicle_imu": (T, {"delta_angle_dt": 4900.0 + s["r"]}),
        "vehicle_local_position": (T, {"heading": s["psi"]}),
        "esc_status": (T, {f"speed_rate_{k}": noise.normal(size=T.size) for k in range(50)}),
        "vehicle_angular_velocity": (T, {"xyz[2]": s["r"]}),
    }
    log = assemble(Path("a.ulg"), "test", topics)
    found = recognise(log)
    assert found["psi"].field == "vehicle_local_position.heading"
    assert found["r"].field == "vehicle_angular_velocity.xyz[2]"
    assert found.get("theta") is None
    assert found.get("rudder") is None
    why = {row["field"]: row["because"] for row in found.rows(log)}
    assert "wanted, not measured" in why["vehicle_attitude_setpoint.yaw_body"]
    record = import_log(log, draft(log)).dataset[0]
    np.testing.assert_allclose(record.output("r"), s["r"], atol=1e-9)


@pytest.mark.parametrize(
    ("header", "unit", "port"),
    [("n_{} [rad/s]", 1.0, "n_port"), ("{} shaft [rpm]", 1 / 60, "port_shaft")],
)
def test_two_propellers_are_two_inputs(header: str, unit: float, port: str) -> None:
    """Commands of one kind keep their fields' names, in revolutions or radians; both are asked."""
    s, ahead = circle(), 30.0 + 5.0 * np.sin(0.05 * T)
    columns = {header.format("port"): ahead, header.format("stbd"): 0.9 * ahead}
    topic = {"Kurs [rad]": s["psi"], "Gierrate [rad/s]": s["r"], **columns}
    log = assemble(Path("a.csv"), "test", {"a": (T, topic)})
    guesses = [one for one in recognise(log).guesses if one.channel]
    assert [one.doubts for one in guesses] == [("field",), ("field",)]
    record = import_log(log, draft(log)).dataset[0]
    np.testing.assert_allclose(record.input(port), unit * ahead, rtol=1e-12)
    stbd = port.replace("port", "stbd")
    np.testing.assert_allclose(record.input(stbd), 0.9 * unit * ahead, rtol=1e-12)


def test_a_field_of_a_channels_name_is_asked_for_its_unit() -> None:
    """It is that channel in its own unit, and asked; an input that is in no field is refused."""
    s = circle()
    port = 28.0 + 4.0 * np.sin(0.03 * T)
    log = log_of(psi=s["psi"], r=s["r"], n_port=port, n_stbd=port)
    names = ("n_port", "n_starboard")
    outputs = (Output("psi", "rad"), Output("r", "rad/s"))
    twins = Channels(tuple(Input(name, "rad/s") for name in names), outputs)
    told = {one.name: one for one in called(recognise(log), twins, log).guesses}
    assert told["n_port"].field == "a.n_port"
    assert (told["n_port"].unit, told["n_port"].doubts) == ("rad/s", ("unit",))
    mapping = draft(log, twins)
    assert set(mapping.inputs) == {"n_port"}
    with pytest.raises(DataError, match=r"no \[inputs.n_starboard\]"):
        import_log(log, mapping, twins)
    record = import_log(log, draft(log, sole := Channels(twins.inputs[:1], outputs)), sole)
    np.testing.assert_allclose(record.dataset[0].input("n_port"), port, atol=0.02)


def test_a_log_across_midnight(tmp_path: Path) -> None:
    """Times of day go on counting and the yaw rate keeps its sign; AM and PM are refused so."""
    s = circle()
    seconds = (86400.0 - 300.0 + T) % 86400.0
    hours, rest = np.divmod(seconds, 3600.0)
    minutes, rest = np.divmod(rest, 60.0)
    times = list(zip(hours.astype(int), minutes.astype(int), rest, strict=True))
    forms = (
        [f"{h:02d}:{m:02d}:{x:04.1f}" for h, m, x in times],
        [f"{(h - 1) % 12 + 1}:{m:02d}:{x:04.1f} {'AP'[h // 12]}M" for h, m, x in times],
    )
    file = tmp_path / "night.csv"
    for stamps in forms:
        cells = zip(stamps, s["psi"], s["r"], strict=True)
        rows = [f"{a},{b:.6f},{c:.8f}" for a, b, c in cells]
        file.write_text("\n".join(["Time,Heading,ROT", *rows]))
        if stamps is forms[1]:
            with pytest.raises(DataError, match="is a time of twelve hours"):
                open_log(file)
            break
        log = open_log(file)
        assert recognise(log)["r"].sign == 1
        record = import_log(log, draft(log)).dataset[0]
        np.testing.assert_allclose(record.times - record.times[0], T, atol=1e-6)


def test_a_clock_that_goes_back_tells_nothing_wrong() -> None:
    """Fields are told by the longest part of a log, and what to do with the rest is said."""
    s = circle()
    back = np.where(T < 400.0, T, T - 400.0)
    log = assemble(Path("a.csv"), "test", {"a": (back, {"Kurs": s["psi"], "Gierrate": s["r"]})})
    found = recognise(log)
    assert (found["r"].sign, found["r"].unit) == (1, "rad/s")
    with pytest.raises(DataError, match="sort those of"):
        import_log(log, draft(log))


def test_first_model_of_positions_without_speeds(tmp_path: Path) -> None:
    """Positions follow from the heading and velocities that are not measured, told by numbers."""
    pull = np.sign(np.sin(0.05 * T))
    u = np.zeros(T.size)
    for k in range(T.size - 1):  # surge with a time constant of 10 s, by Euler's method
        u[k + 1] = u[k] + 0.5 * (0.3 * pull[k] - 0.1 * (u[k] - 2.0))
    psi = 1.0 + 2.5 * np.sin(0.02 * T)
    way = np.cumsum(u * np.exp(1j * psi)) * 0.5
    table = np.column_stack([T, pull, psi, 0.05 * np.cos(0.02 * T), way.real, way.imag])
    log = tmp_path / "boat.csv"
    header = "t [s],thrust [N],psi [rad],r [rad/s],x [m],y [m]"
    np.savetxt(log, table, delimiter=",", header=header, comments="")
    model = load_problem(new_problem(tmp_path / "boat", log=log)).model
    assert model.kinematics["x"] == "u*cos(psi) - v*sin(psi)"
    assert set(model.state_names) - set(model.output_names) == {"u", "v"}
    values = {p.name: p.value for p in model.parameters}
    assert values["u_thrust"] == pytest.approx(0.3, rel=0.15)
    assert values["u_u"] == pytest.approx(-0.1, rel=0.15)


def test_a_command_that_never_moves_is_an_input_and_nothing_more(tmp_path: Path) -> None:
    """No limit, lag or coefficient of a thrust that was the same all the time."""
    s, rudder = circle(), 0.2 * np.sign(np.sin(0.04 * T))
    columns = zip(T, s["psi"], s["r"], rudder, np.full(T.size, 9.0), strict=True)
    log = tmp_path / "log.csv"
    rows = [",".join(f"{x:.6f}" for x in row) for row in columns]
    header = "t [s],psi [rad],r [rad/s],rudder [rad],thrust [N]"
    log.write_text("\n".join([header, *rows]))
    problem = load_problem(new_problem(tmp_path / "boat", log=log))
    assert problem.model.input_names == ("rudder", "thrust")
    assert set(problem.limits.inputs) == {"rudder"}
    assert not [p.name for p in problem.model.all_parameters if "thrust" in p.name]
    np.testing.assert_allclose(problem.data()[0].input("thrust"), 9.0)


def test_a_starter_takes_commands_by_name_and_unit(tmp_path: Path, capsys) -> None:
    """Of a log of any format; what was told and what is asked is printed."""
    s, force = circle(), 5.0 * np.sign(np.sin(0.04 * T))
    rows = [f"{a:.1f},{b:.6f},{c:.8f},{d:.1f}"
            for a, b, c, d in zip(T, s["psi"], s["r"], force, strict=True)]  # fmt: skip
    log = tmp_path / "rov.csv"
    log.write_text("\n".join(["time,heading,yaw_rate,jet", *rows]))
    with pytest.raises(ProblemError, match="Name commands with inputs"):
        new_problem(tmp_path / "a", log=log)
    with pytest.raises(ProblemError, match=r"Say it with the name, as 'jet \[N\]'"):
        new_problem(tmp_path / "b", log=log, inputs=("jet",))
    assert main(["new", str(tmp_path / "c"), "--from", str(log), "--input", "jet [kN]"]) == DONE
    assert "2 fields recognised" in capsys.readouterr().out
    (record,) = load_problem(tmp_path / "c").data()
    np.testing.assert_allclose(record.input("jet"), 1e3 * force)
    log.write_text("\n".join(["t [s],psi [rad],rudder [rad],jet", *rows]))
    with pytest.warns(UnitWarning, match="left out for want of a unit: jet"):
        new_problem(tmp_path / "d", log=log)
