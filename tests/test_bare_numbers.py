"""Models whose expressions hold bare numbers: read with a note, refused only where nothing helps.

Seven folders as people write them, each with the number that a note has to name
and with changes that no unit of a number could mend.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from oed_sysid import load_problem
from oed_sysid.errors import ModelError, ProblemError
from oed_sysid.testing import check_problem
from oed_sysid.text.dimensions import Deduction, dimension_of
from oed_sysid.text.units import Dimension, dimension

HEAD = "from oed_sysid import Force, Input, Model, Output, Parameter, Problem, Sensor, State\n"
SHIP = """
hull = Force("hull", {"Y": "0.5*1025*2500*U*v*Y_v", "N": "0.5*1025*2500*180*U*v*N_v"},
             (Parameter("Y_v", -0.01), Parameter("N_v", -0.004, "1")))
screw = Force("screw", {"X": "1025*(1 - 0.2)*8.5**4*0.4*n_p**2 - 38.2*U**2"}, ())
model = Model("ship",
    states=(State("psi", "rad"), State("u", "m/s"), State("v", "m/s"), State("r", "rad/s")),
    inputs=(Input("delta", "rad"), Input("n_p", "1/s")),
    outputs=(Output("psi", "rad", noise_std=0.01), Output("r", "rad/s", noise_std=0.001)),
    axes={"X": "u", "Y": "v", "N": "r"},
    inertia={("X", "u"): "m + 0.05*m", ("Y", "v"): "m + 2.1e7", ("N", "r"): "I_z"},
    kinematics={"psi": "r"}, signals={"U": "sqrt(u**2 + v**2)"},
    parameters=(Parameter("m", 3e7, "kg"), Parameter("I_z", 6e10, "kg m^2")),
    effects=(hull, screw), step=1.0)
late = Force("late", {"Y": "E_late*v*abs(v)*exp(-3*U/7.7)"},
    (Parameter("E_late", 0.0, "kg/m", scale=1.0),))
problem = Problem("folder", model, effects=(late,))
"""
WHEEL = """
model = Model("wheel", states=(State("v", "m/s"), State("w", "rad/s")),
    inputs=(Input("torque", "N m"),),
    outputs=(Output("v", "m/s", noise_std=0.01), Output("w", "rad/s", noise_std=0.1)),
    kinematics={"v": "F/320", "w": "(torque - 0.31*F - c*w)/1.2"},
    signals={"slip": "(0.31*w - v)/max(abs(v), 0.1)", "F": "3200*mu*sin(1.4*atan(11*slip))"},
    parameters=(Parameter("mu", 0.9, "1"), Parameter("c", 0.1, "N m s")), step=0.01)
scrub = Force("scrub", {"w": "-E_scrub*tanh(w/0.05)"},
    (Parameter("E_scrub", 0.0, "rad/s^2", scale=1.0),))
problem = Problem("folder", model, effects=(scrub,))
"""
FLOAT = """
model = Model("float", states=(State("z", "m"), State("w", "m/s")), inputs=(Input("eta", "m"),),
    outputs=(Output("z", "m", noise_std=0.001),),
    axes={"Z": "w"}, inertia={("Z", "w"): "512.0"}, kinematics={"z": "w"},
    effects=(Force("water", {"Z": "K*(eta - z) - 90*w - 410*w*abs(w)"},
        (Parameter("K", 9810.0, "N/m"),)),),
    step=0.05)
stop = Force("stop", {"Z": "where(abs(z) > 0.4, -E_stop*(abs(z) - 0.4)*sign(z), 0)"},
             (Parameter("E_stop", 0.0, "N/m", scale=1e4),))
problem = Problem("folder", model, effects=(stop,))
"""
BENCH = """
model = Model("bench", states=(State("x", "m"), State("v", "m/s")), inputs=(Input("F", "N"),),
    outputs=(Output("x", "m", noise_std=1e-5),),
    kinematics={"x": "v", "v": "(F - c*v - (1.5 + 0.8*exp(-(v/0.02)**2))*tanh(v/0.001))/m"},
    parameters=(Parameter("m", 2.0, "kg"), Parameter("c", 4.0, "N s/m")), step=0.01)
drift = Sensor("drift", {"x": "x + E_x*(t/60)"}, (Parameter("E_x", 0.0, "m"),))
problem = Problem("folder", model, effects=(drift,))
"""
TANK = """
model = Model("tank", states=(State("h1", "m"),), inputs=(Input("pump", "V"),),
    outputs=(Output("h1", "m", noise_std=0.001),),
    kinematics={"h1": "(3.3e-6*min(pump, 12) - a*sqrt(2*9.81*h1))/0.0028"},
    parameters=(Parameter("a", 7e-6, "m^2"),), step=1.0)
problem = Problem("folder", model)
"""
GLIDER = """
model = Model("glider", states=(State("depth", "m"), State("theta", "rad"), State("q", "rad/s")),
    inputs=(Input("battery", "m"),),
    outputs=(Output("depth", "m", noise_std=0.1), Output("theta", "rad")),
    axes={"M": "q"}, inertia={("M", "q"): "65"},
    kinematics={"depth": "-0.35*sin(theta)", "theta": "q"}, signals={"rho": "1025*(1 + depth/2e5)"},
    effects=(Force("pitch", {"M": "-9.81*9*battery*cos(theta) + rho/1000*M_q*q*0.35"},
                   (Parameter("M_q", -400.0, "N m s"),)),), step=0.5)
problem = Problem("folder", model)
"""
DRIVE = """
model = Model("drive", states=(State("i", "A"), State("n", "1/s")), inputs=(Input("u_a", "V"),),
    outputs=(Output("n", "1/s", noise_std=0.1),),
    kinematics={"i": "(u_a - R*i - 0.23*n)/0.0015", "n": "(0.037*i - 1e-4*n - 2.5e-5*n**2)/J"},
    parameters=(Parameter("R", 1.1, "Ohm"), Parameter("J", 2e-3)), step=0.001)
problem = Problem("folder", model)
"""

# Kind, text, notes that it has to give, and what each of its changes is refused with.
FOLDERS = [
    (
        "ship",
        SHIP,
        ("N: 0.5*1025*2500*180 is read as kg.", "X: 38.2 is read as kg/m.", "3/7.7 is read as s/m"),
        (
            ("sqrt(u**2 + v**2)", "sqrt(u**2 + r**2)", "m^2/s^2 meets rad^2/s^2"),
            ("exp(-3*U/7.7)", "exp(-U)", "m/s meets 1"),
            ("m + 0.05*m", "m + I_z", "kg meets kg m^2"),
        ),
    ),
    (
        "wheel",
        WHEEL,
        (
            "signal 'slip': 0.31 is read as m",
            "0.1 is read as m/s",
            "0.05 is read as 1/s",
            "1.2 is read as kg m^2",
        ),
        (
            ("tanh(w/0.05)", "tanh(w)", "rad/s meets 1"),
            ("(0.31*w - v)", "(w - v)", "rad/s meets m/s"),
        ),
    ),
    (
        "float",
        FLOAT,
        (
            "512.0 is read as kg.",
            "90 is read as kg/s.",
            "410 is read as kg/m.",
            "0.4 is read as m.",
        ),
        (
            ("K*(eta - z)", "K*(eta - w)", "m meets m/s"),
            ("abs(z) > 0.4", "abs(z) > w", "m meets m/s"),
        ),
    ),
    (
        "bench",
        BENCH,
        ("1.5 is read as N.", "0.8 is read as N.", "0.02 is read as m/s.", "60 is read as s."),
        (
            ("v/0.02", "v/m", "m^2"),
            ("F - c*v", "F - c*x", "N meets"),
            ("E_x*(t/60)", "E_x*t", "m meets m s"),
        ),
    ),
    (
        "tank",
        TANK,
        ("12 is read as V", "0.0028, 3.3e-6, 2*9.81 have units that follow from one another"),
        (
            ("2*9.81*h1", "2*9.81*(h1 + a)", "m meets m^2"),
            ("min(pump, 12)", "min(pump, h1)", "meets m"),
        ),
    ),
    (
        "glider",
        GLIDER,
        ("65 is read as kg m^2", "9.81*9 is read as N", "2e5 is read as m"),
        (
            ("cos(theta)", "cos(depth)", "m meets 1"),
            ('theta": "q', 'theta": "depth', "expected rad/s"),
        ),
    ),
    (
        "drive",
        DRIVE,
        ("0.23 is read as s V", "0.0015 is read as kg m^2/(s^2 A^2)"),
        (("u_a - R*i", "u_a - R*n", "meets"), ("u_a - R*i", "u_a - i", "V meets A")),
    ),
]


def write(folder: Path, text: str) -> Path:
    """A folder with this problem."""
    place = folder / "folder"
    place.mkdir()
    (place / "problem.py").write_text(HEAD + text)
    return place


@pytest.mark.parametrize(
    ("text", "expected"), [one[1:3] for one in FOLDERS], ids=[one[0] for one in FOLDERS]
)
def test_folder_loads_and_says_how_it_was_read(
    tmp_path: Path, text: str, expected: tuple[str, ...]
) -> None:
    """A folder with bare numbers loads, and notes say which number got which unit."""
    problem = load_problem(write(tmp_path, text))
    said = "\n".join(problem.notes())
    for words in expected:
        assert words in said
    assert f"note: {problem.notes()[0]}" in problem.describe()


@pytest.mark.parametrize(
    ("text", "old", "new", "words"),
    [(text, *change) for _, text, _, changes in FOLDERS for change in changes],
)
def test_what_no_number_mends_is_refused(
    tmp_path: Path, text: str, old: str, new: str, words: str
) -> None:
    """The same folders, each with one fault that stands in the declared units."""
    assert text.count(old) >= 1
    with pytest.raises(ProblemError) as caught:
        load_problem(write(tmp_path, text.replace(old, new, 1)))
    assert words in str(caught.value)


def test_contract_prints_notes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The check of a folder prints how its bare numbers were read."""
    with pytest.raises(AssertionError, match=r"has no README\.md"):
        check_problem(write(tmp_path, FLOAT), rng=np.random.default_rng(0), effects=False)
    assert "512.0 is read as kg." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "notes"),
    [
        ("2*w + 0.5*w", ()),
        ("w*(1 + 3*theta)", ()),
        ("max(w, 0) + 1e-9", ()),
        ("w*(1 + 3*w)", ("3 is read as s/m",)),
        ("w*(1 - theta/20)*30/(2*pi)", ()),
        ("w*sin(pi*q/30)", ("30 is read as 1/s",)),
        ("sqrt(9.81*h)", ("9.81 is read as m/s^2",)),
        ("clip(w, -0.6, 0.7)", ("0.6 is read as m/s", "0.7 is read as m/s")),
        ("0.7*h**1.7/4.2**0.7", ("0.7/4.2**0.7 is read as 1/(m^(7/10) s)",)),
        ("h**(1/2)*3**0.5", ("3**0.5 is read as m^(1/2)/s",)),
        ("w*(q/3)**theta", ("3 is read as 1/s",)),
        ("w if q > 4 else 5", ("4 is read as 1/s", "5 is read as m/s")),
        ("K*w + 3", ("3 is read as m/s",)),
        ("K*w + 3*K", ()),
    ],
)
def test_notes_of_an_expression(text: str, notes: tuple[str, ...]) -> None:
    """A number is named where only a unit makes it fit, and not where none is needed."""
    units = {"w": "m/s", "q": "rad/s", "theta": "rad", "h": "m"}
    known = {name: dimension(unit) for name, unit in units.items()}
    found = Deduction()
    form = found.form(text, known, where="here")
    if form is not None:
        assert found.equal(form, dimension("m/s"))
    said = [line.removeprefix("here: ").removesuffix(".") for line in found.notes()]
    assert [line.replace("-", "") for line in said] == list(notes)


@pytest.mark.parametrize("text", ["sin(h)", "3*h + 2*sin(h)", "w**h", "(w + q)*3", "2**w"])
def test_expression_that_no_number_mends(text: str) -> None:
    """A number beside the fault does not excuse it."""
    known = {"h": dimension("m"), "w": dimension("m/s"), "q": dimension("rad/s")}
    with pytest.raises(ModelError, match="In "):
        dimension_of(text, known)


def test_number_in_a_signal_is_read_where_the_signal_is_used(tmp_path: Path) -> None:
    """Numbers of one model have one unit each, however far from where it shows."""
    text = SHIP.replace("0.5*1025*2500*U*v*Y_v", "Q*2500*v/U*Y_v").replace(
        "sqrt(u**2 + v**2)", 'sqrt(u**2 + v**2)", "Q": "512.5*U**2'
    )
    problem = load_problem(write(tmp_path, text.replace('"Y_v", -0.01', '"Y_v", -0.01, "m^2"')))
    assert "signal 'Q': 512.5" in "\n".join(problem.notes())


UNITS = {"w": "m/s", "h": "m", "q": "rad/s", "m": "kg", "F": "N", "a": "1"}


def draw(rng: np.random.Generator, unit: Dimension, depth: int) -> str:
    """An expression in a unit, written by somebody who knows what their numbers stand for."""
    name = str(rng.choice(list(UNITS)))
    if depth == 0:
        # A number in whatever unit is needed, or one that brings a name into it.
        power = int(rng.choice([-2, -1, 1, 2]))
        return str(
            rng.choice([f"{rng.uniform(3, 99):.3g}", f"{rng.uniform(3, 99):.3g}*{name}**{power}"])
        )
    match rng.integers(7):
        case 0:
            parts = [draw(rng, unit, depth - 1) for _ in range(2)]
            return f"({parts[0]} + {parts[1]})"
        case 1:
            other = dimension(UNITS[name])
            return f"{name}*({draw(rng, unit / other, depth - 1)})"
        case 2:
            other = dimension(UNITS[name])
            return f"({draw(rng, unit * other, depth - 1)})/{name}"
        case 3:
            inner = draw(rng, Dimension(), depth - 1)
            return f"({draw(rng, unit, depth - 1)})*{rng.choice(['tanh', 'atan'])}({inner})"
        case 4:
            return f"max({draw(rng, unit, depth - 1)}, {draw(rng, unit, depth - 1)})"
        case 5:
            return f"sqrt({draw(rng, unit**2, depth - 1)})"
    condition = f"{draw(rng, unit, depth - 1)} > {draw(rng, unit, depth - 1)}"
    return f"where({condition}, {draw(rng, unit, depth - 1)}, 0)"


@pytest.mark.parametrize("seed", range(6))
def test_whatever_can_be_right_loads(seed: int) -> None:
    """Expressions drawn with a unit in mind have a solution, whichever of their units is stated."""
    rng = np.random.default_rng(seed)
    known = {name: dimension(unit) for name, unit in UNITS.items()}
    for _ in range(60):
        unit = dimension(str(rng.choice(list(UNITS.values()))))
        text = draw(rng, unit, int(rng.integers(1, 5)))
        stated = {n: form if rng.random() < 0.8 else None for n, form in known.items()}
        units = Deduction()
        form = units.form(text, stated)
        assert form is None or units.equal(form, unit), text


@pytest.mark.parametrize("seed", range(3))
def test_a_clash_of_declared_units_is_found_at_any_depth(seed: int) -> None:
    """One clash between names alone makes an expression wrong, whatever surrounds it."""
    rng = np.random.default_rng(seed)
    known = {name: dimension(unit) for name, unit in UNITS.items()}
    for _ in range(40):
        one, other = rng.choice(["w", "h", "m", "F"], 2, replace=False)
        text = draw(rng, dimension("N"), 2)
        clash = str(rng.choice([f"({one} + {other})", f"sin({one})", f"max({one}, {other}*a)"]))
        with pytest.raises(ModelError, match="meets"):
            dimension_of(f"({text})*{clash}", known)


def test_unknown_name_says_how_to_declare_it(tmp_path: Path) -> None:
    """A name that nobody declared is refused with the line that would declare it."""
    text = SHIP.replace("0.5*1025*2500*U*v*Y_v", "0.5*rho*2500*U*v*Y_v")
    with pytest.raises(ProblemError, match=r'Parameter\("rho", value, "unit"\)'):
        load_problem(write(tmp_path, text))
