"""Problem files that cannot be worked with, with what has to be said about each when loaded.

``SOUND`` is a small problem that loads; most entries of ``REFUSED`` change one
text in it. Each entry: kind, source (or files of the folder by name), words.
"""

from __future__ import annotations

SOUND = """\
from oed_sysid import Actuator, Experiment, Force, Input, Limits, Model, Output, Parameter
from oed_sysid import Problem, Sensor, State
from oed_sysid.experiments.manoeuvres import ZigZag

model = Model(
    name="ferry",
    states=(State("psi", "rad"), State("r", "rad/s", scale=0.05)),
    inputs=(Input("rudder", "rad"),),
    outputs=(Output("psi", "rad", noise_std=0.01), Output("r", "rad/s")),
    kinematics={"psi": "r", "r": "(K*rudder - r)/T"},
    signals={"slip": "r*T"},
    parameters=(Parameter("K", 0.1, "1/s", lower=0.0, upper=1.0), Parameter("T", 12.0, "s")),
    step=0.5,
)
drag = Force("drag", {"r": "-E_drag*r*abs(r)"}, (Parameter("E_drag", 0.0, "1", scale=0.1),))
bias = Sensor("bias", {"psi": "psi + E_bias"}, (Parameter("E_bias", 0.0, "rad"),))
problem = Problem(
    name="ferry",
    model=model,
    effects=(drag, bias),
    experiments={"still": Experiment("still", duration=60.0, constants={"rudder": 0.1})},
    limits=Limits(inputs={"rudder": (-0.6, 0.6)}),
    truth={"K": 0.12, "E_drag": 0.3},
)
"""


def swap(old: str, new: str) -> str:
    """The sound problem with one text replaced."""
    assert SOUND.count(old) >= 1, old
    return SOUND.replace(old, new, 1)


def end(text: str) -> str:
    """The sound problem with a text after it."""
    return SOUND + text


# kind, source or files by name, words
REFUSED: tuple[tuple[str, str | dict[str, str | bytes], tuple[str, ...]], ...] = (
    # -- the file
    ("empty", "", ("does not export 'problem'", "it defines nothing")),
    ("another name", swap("problem = P", "task = P"), ("a Problem called 'task': rename it",)),
    ("a number", "problem = 3\n", ("its 'problem' is a int", "problem = Problem(...)")),
    ("the class itself", end("problem = Problem\n"), ("its 'problem' is a type",)),
    ("a function", end("def problem(): ...\n"), ("its 'problem' is a function",)),
    ("a model", end("problem = model\n"), ("its 'problem' is a Model",)),
    ("a list", end("problem = [problem]\n"), ("its 'problem' is a list",)),
    ("bracket not closed", swap("),\n    step", ",\n    step"), ("line", "Correct this line")),
    ("indentation", "  " + SOUND, ("line 1", "unexpected indent")),
    ("words", "Dear colleague,\nhere is the model.\n", ("line 1", "invalid syntax")),
    ("zero bytes", {"problem.py": b"a = 1\0\n"}, ("null bytes",)),
    ("Latin-1", {"problem.py": b"name = '\xe9'\n"}, ("'utf-8' codec", "problem.py")),
    ("binary", {"problem.py": bytes(range(128, 256))}, ("problem.py", "utf-8")),
    ("no file", {"model.py": SOUND}, ("has no problem.py; it holds model.py",)),
    ("folder of that name", {"problem.py/a.txt": ""}, ("has no problem.py",)),
    # -- what happens while it runs
    ("division by zero", "x = 1\ny = x / 0\n", ("line 2", "ZeroDivisionError")),
    ("unknown module", "import no_such_thing_at_all\n", ("line 1", "Install it", "from .name")),
    ("unknown part of the package", "from oed_sysid import Modell\n", ("line 1", "Modell")),
    ("unknown name", end("x = Parmeter\n"), ("NameError", "Parmeter")),
    ("sys.exit", end("import sys\nsys.exit(0)\n"), ("ends the program", "__main__")),
    ("exit", end("raise SystemExit\n"), ("ends the program",)),
    ("exception without words", end("raise RuntimeError\n"), ("RuntimeError: no message",)),
    ("exception of its own", end("class E(BaseException): ...\nraise E('x')\n"), ("E: x",)),
    ("assertion", end("assert model.step == 1\n"), ("AssertionError",)),
    ("endless recursion", "def f():\n    return f()\nf()\n", ("line 2", "without end")),
    (
        "imports itself",
        {"problem.py": "from .problem import problem\n"},
        ("circular import",),
    ),
    (
        "fault in another file of the folder",
        {"problem.py": "from .hull import HULL\n", "hull.py": "a = 1\nHULL = a / 0\n"},
        ("hull.py, line 2", "ZeroDivisionError"),
    ),
    (
        "syntax error in another file of the folder",
        {"problem.py": "from .hull import HULL\n", "hull.py": "HULL = (\n"},
        ("hull.py, line 1", "Correct this line"),
    ),
    ("missing file", end("open('no/such/file.csv')\n"), ("FileNotFoundError", "no/such/file.csv")),
    # -- parts of another kind
    ("unknown option", swap("step=0.5", "stepp=0.5"), ("stepp", "Check the spelling")),
    ("model missing", swap("    model=model,\n", ""), ("model",)),
    ("name missing", swap('    name="ferry",\n    model=', "    model="), ("name",)),
    ("model as text", swap("    model=model,", "    model='m',"), ("model is a str", "expected Model(...)")),
    ("name as number", swap('name="ferry",\n    model=', "name=7,\n    model="), ("is a int",)),
    ("name with a space", swap('name="ferry",\n    m', 'name="a b",\n    m'), ("no identifier",)),
    ("one effect alone", swap("(drag, bias)", "drag"), ("effects is a Force", "(effect,)")),
    ("effect as text", swap("(drag, bias)", "('drag',)"), ("one of its effects is a str",)),
    ("one state alone", swap('(State("psi", "rad"), State("r", "rad/s", scale=0.05))',
                             'State("r", "rad/s")'), ("states is a State", "(state,)")),
    ("state as text", swap('State("psi", "rad")', "'psi'"), ("one of its states is a str",)),
    ("kinematics as text", swap('{"psi": "r", "r": "(K*rudder - r)/T"}', "'r'"),
     ("kinematics is a str", "mapping")),
    ("rate as a number", swap('"psi": "r"', '"psi": 0.1'), ("expression is text", "float")),
    ("parameters as numbers", swap('Parameter("T", 12.0, "s")', "12.0"),
     ("one of its parameters is a float",)),
    ("experiments as a list", swap('{"still": Experiment("still", duration=60.0, '
                                   'constants={"rudder": 0.1})}', "[1]"), ("experiments is a list",)),
    ("experiment as text", swap('"still": Experiment("still", duration=60.0, '
                                'constants={"rudder": 0.1})', '"a": "b"'),
     ("experiments['a'] is a str",)),
    ("limits as a mapping", swap('Limits(inputs={"rudder": (-0.6, 0.6)})', "{}"),
     ("limits is a dict", "Limits(...)")),
    ("truth as text", swap('{"K": 0.12, "E_drag": 0.3}', '"yes"'), ("truth is a str",)),
    ("true value as text", swap('"K": 0.12', '"K": "0.12"'), ("truth of 'K' is '0.12'",)),
    ("true value NaN", swap('"K": 0.12', '"K": float("nan")'), ("truth of 'K' is nan",)),
    ("records as a list", swap("    truth=", "    records=[],\n    truth="),
     ("records is a list", "function")),
    ("reference alone", swap("    truth=", "    references='Nomoto',\n    truth="),
     ("references is a str",)),
    # -- parameters
    ("value NaN", swap("12.0", "float('nan')"), ("'T' has value NaN",)),
    ("value infinite", swap("12.0", "float('inf')"), ("'T' has value inf",)),
    ("value as text", swap("12.0", "'12'"), ("'T' has value '12'", "Expected a number")),
    ("value None", swap("12.0", "None"), ("'T' has value None",)),
    ("bounds inverted", swap("lower=0.0, upper=1.0", "lower=1.0, upper=0.0"), ("Swap them",)),
    ("value outside its bounds", swap("upper=1.0", "upper=0.01"), ("outside its bounds [0, 0.01]",)),
    ("bound NaN", swap("upper=1.0", "upper=float('nan')"), ("'K' has upper NaN",)),
    ("prior outside the bounds", swap("upper=1.0", "upper=1.0, prior_mean=2.0, prior_std=0.1"),
     ("'K' has its prior at 2", "outside its bounds [0, 1]")),
    ("prior without spread", swap("upper=1.0", "upper=1.0, prior_mean=0.1, prior_std=0.0"),
     ("prior_std 0.0",)),
    ("prior of infinite spread", swap("upper=1.0", "upper=1.0, prior_std=float('inf')"),
     ("prior_std inf",)),
    ("prior NaN", swap("upper=1.0", "upper=1.0, prior_mean=float('nan')"), ("prior_mean nan",)),
    ("scale zero", swap("upper=1.0", "upper=1.0, scale=0.0"), ("'K' has scale 0.0",)),
    ("parameter twice", swap('Parameter("T"', 'Parameter("K"'), ("parameter 'K' twice",)),
    ("parameter called as a state", swap('Parameter("T"', 'Parameter("r"'), ("'r' for two things",)),
    ("parameter called t", swap('Parameter("T"', 'Parameter("t"'), ("'t' is reserved",)),
    ("parameter with a space", swap('Parameter("T"', 'Parameter("T 1"'), ("'T 1' cannot be named",)),
    ("word of Python", swap('Parameter("T"', 'Parameter("lambda"'), ("'lambda' cannot be named",)),
    ("parameter of the effect taken", SOUND.replace("E_bias", "K"), ("'K' twice",)),
    # -- units
    ("unknown unit", swap('12.0, "s"', '12.0, "sec"'), ("'T'", "Unknown unit 'sec'")),
    ("unit as number", swap('12.0, "s"', "12.0, 1"), ("'T'", "A unit is text")),
    ("unit of a state unknown", swap('State("psi", "rad")', 'State("psi", "grad")'),
     ("State 'psi'", "Unknown unit 'grad'")),
    ("unit with a huge exponent", swap('12.0, "s"', '12.0, "s^999999999"'), ("beyond 12",)),
    ("rate in another unit", swap('"psi": "r"', '"psi": "r*T"'),
     ("rate of 'psi': 'r*T' is in rad", "expected rad/s")),
    ("unlike things added", swap("K*rudder - r", "K*rudder - psi"),
     ("rate of 'r'", "rad/s meets rad")),
    ("sine of a time", swap("K*rudder - r", "K*sin(T)*rudder - r"), ("rate of 'r'", "s meets 1")),
    ("parameter in another unit", swap('"K", 0.1, "1/s"', '"K", 0.1, "m"'), ("m rad meets rad/s",)),
    ("output in another unit", swap('Output("r", "rad/s")', 'Output("r", "m")'),
     ("output 'r': 'r' is in rad/s, expected m",)),
    ("effect in another unit", swap('"E_drag", 0.0, "1"', '"E_drag", 0.0, "kg"'),
     ("effect 'drag', r", "is in kg rad^2/s^2")),
    ("sensor in another unit", swap('"E_bias", 0.0, "rad"', '"E_bias", 0.0, "m"'),
     ("effect 'bias'", "rad meets m")),
    # -- names and definitions
    ("rate of an unknown state", swap('"psi": "r"', '"psi": "r", "x": "r"'), ("unknown state 'x'",)),
    ("state without a rate", swap('"psi": "r", ', ""), ("State 'psi'", "0 equations")),
    ("unknown name in a rate", swap("K*rudder", "K*ruder"), ("'ruder'", "Did you mean rudder")),
    ("input missing", swap('Input("rudder", "rad"),', ""), ("unknown name 'rudder'",)),
    ("output of an unknown state", swap('Output("r", "rad/s")', 'Output("q", "rad/s")'),
     ("output 'q'", "unknown name 'q'")),
    ("unknown function", swap("K*rudder", "sinus(K)*rudder"), ("unknown function 'sinus'",)),
    ("wrong number of arguments", swap("abs(r)", "abs(r, 2)"), ("got 2 arguments, expected 1",)),
    ("expression not closed", swap("(K*rudder - r)/T", "(K*rudder - r/T"), ("never closed",)),
    ("expression that calls Python", swap("K*rudder", "__import__('os').getpid()*rudder"),
     ("Expression",)),
    ("power with a hat", swap("r*abs(r)", "r^2"), ("BitXor", "Write ** for a power")),
    ("root of a negative number", swap("r*abs(r)", "r*(-1)**0.5"), ("no finite real number",)),
    ("number beyond all numbers", swap("r*abs(r)", "r*10**400"), ("no finite real number",)),
    ("division by zero in a rate", swap("- r)/T", "- r)/0"), ("divides by zero",)),
    ("signal in a circle", swap('{"slip": "r*T"}', '{"a": "b*T", "b": "a/T"}'), ("in a circle",)),
    ("signal from itself", swap('{"slip": "r*T"}', '{"slip": "slip + r*T"}'), ("in a circle",)),
    ("signal before its parts", swap('{"slip": "r*T"}', '{"a": "b*T", "b": "r"}'),
     ("uses 'b': that is defined after it",)),
    ("no state", swap('(State("psi", "rad"), State("r", "rad/s", scale=0.05))', "()"),
     ("at least one state",)),
    ("step of zero", swap("step=0.5", "step=0.0"), ("step 0.0", "above zero")),
    ("step NaN", swap("step=0.5", "step=float('nan')"), ("step nan",)),
    ("sign of two", swap('Output("r", "rad/s")', 'Output("r", "rad/s", sign=2)'), ("sign 2",)),
    ("unknown interpolation", swap('Input("rudder", "rad")',
                                   'Input("rudder", "rad", interpolation="cubic")'), ("'cubic'",)),
    # -- candidates, experiments, limits, truth
    ("effect twice", swap("(drag, bias)", "(drag, drag)"), ("two candidates called 'drag'",)),
    ("effect that the model has", swap("    model=model,", "    model=model + drag,"),
     ("contains already",)),
    ("effect on an unknown state", swap('{"r": "-E_drag*r*abs(r)"}', '{"q": "-E_drag*r*abs(r)"}'),
     ("candidate 'drag' does not fit", "'q'")),
    ("effect without terms", swap('{"r": "-E_drag*r*abs(r)"}', "{}"), ("contributes nothing",)),
    ("effect that is there at zero", swap('"-E_drag*r*abs(r)"', '"-(E_drag + 0.1)*r*abs(r)"'),
     ("effect 'drag': with zero amplitudes (E_drag) it still changes 'r'",)),
    ("sensor that is there at zero", swap('"psi + E_bias"', '"2*psi + E_bias"'),
     ("effect 'bias': with zero amplitudes (E_bias) it still changes 'psi'",)),
    ("amplitude that cannot be zero", swap('"E_drag", 0.0, "1"', '"E_drag", 0.5, "1", lower=0.1'),
     ("amplitude 'E_drag' cannot be zero",)),
    ("amplitude of another effect", swap("(drag, bias)", "(Force('x', {'r': '-E*r'}, (Parameter("
                                         "'E', 0.0, '1/s'),), amplitudes=('F',)), bias)"),
     ("names the amplitude 'F'",)),
    ("experiment without its command", swap('constants={"rudder": 0.1}', "constants={}"),
     ("'still'", "rudder")),
    ("experiment of an unknown input", swap('constants={"rudder": 0.1}', 'constants={"rudder": 0.1,'
                                            ' "fin": 0.1}'), ("'fin'",)),
    ("experiment of no duration", swap("duration=60.0", "duration=0.0"), ("still", "0.0")),
    ("limits inverted", swap("(-0.6, 0.6)", "(0.6, -0.6)"), ("rudder",)),
    ("limit of an unknown signal", swap('{"rudder": (-0.6, 0.6)}', '{"fin": (-0.6, 0.6)}'),
     ("'fin'",)),
    ("truth of an unknown parameter", swap('"E_drag": 0.3', '"E_drg": 0.3'),
     ("the parameter 'E_drg'", "Did you mean 'E_drag'")),
    ("model of another name as default", swap("    truth=", "    models={'default': model + drag},\n"
                                              "    truth="), ("two default models",)),
    # -- the file, again
    ("below __main__", swap("problem = Problem(", "if __name__ == '__main__':\n  problem = Problem("),
     ("does not export 'problem'", "outside of if __name__ == '__main__'")),
    ("waits for a key", "gain = float(input())\n" + SOUND, ("line 1", "to be typed")),
    ("tabs and spaces", "if True:\n\tx = 1\n        y = 2\n" + SOUND, ("line 3", "tabs")),
    ("UTF-16", {"problem.py": SOUND.encode("utf-16")}, ("UTF-16", "UTF-8")),
    ("import from above the folder", "from ..other import x\n" + SOUND, ("line 1", "beyond")),
    ("coroutine", "async def f(): ...\nproblem = f()\nproblem.close()\n",
     ("its 'problem' is a coroutine",)),
    ("warnings as errors", "import warnings\nwarnings.simplefilter('error')\nwarnings.warn('old')\n",
     ("line 3", "UserWarning: old")),
    # -- channels, again
    ("output twice", swap('Output("r", "rad/s")', 'Output("psi", "rad", column="heading")'),
     ("two outputs 'psi'",)),
    ("column read twice", swap('Output("r", "rad/s")', 'Output("r", "rad/s", column="psi")'),
     ("'psi' and 'r'", "both read the column 'psi'", "count twice")),
    ("input twice", swap('Input("rudder", "rad"),', 'Input("rudder", "rad"), Input("rudder", "rad"),'),
     ("'rudder' for two things",)),
    ("wrap of a rate", swap('Output("r", "rad/s")', 'Output("r", "rad/s", wrap=True)'),
     ("'r' in [rad/s] cannot wrap",)),
    ("noise as text", swap("noise_std=0.01", "noise_std='1 deg'"), ("noise_std '1 deg'",)),
    # -- parameters, again
    ("fixed as text", swap('12.0, "s"', '12.0, "s", fixed="no"'),
     ("'T' has fixed 'no'", "True or False")),
    ("vector as a value", swap("12.0", "__import__('numpy').ones(2)"), ("'T' has value", "a number")),
    ("logarithm of a negative value", swap('12.0, "s"', '-12.0, "s", log=True'), ("log=True",)),
    ("truth outside the bounds", swap('"K": 0.12', '"K": 12.0'),
     ("truth of 'K' as 12", "outside its bounds [0, 1]")),
    # -- tables
    ("table that is not sorted", SOUND.replace("K*rudder", "lift(psi)*K*rudder").replace(
        "step=0.5,", "step=0.5, tables={'lift': ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0])},"),
     ("Table 'lift'", "does not increase")),
    ("table with a gap", SOUND.replace("K*rudder", "lift(psi)*K*rudder").replace(
        "step=0.5,", "step=0.5, tables={'lift': ([0.0, 1.0], [1.0, float('nan')])},"),
     ("Table 'lift'", "not finite")),
    ("table that is not called", SOUND.replace("K*rudder", "lift*K*rudder").replace(
        "step=0.5,", "step=0.5, tables={'lift': ([0.0, 1.0], [1.0, 1.0])},"),
     ("unknown name 'lift'",)),
    # -- experiments and limits, again
    ("experiment of endless length", swap("duration=60.0", "duration=1e9"), ("1e+10 samples",)),
    ("experiment beyond the limits", swap('constants={"rudder": 0.1}', 'constants={"rudder": 10.0}'),
     ("holds 'rudder' at 10", "[-0.6, 0.6]")),
    ("start of an unknown state", swap("duration=60.0", "duration=60.0, initial={'x': 1.0}"),
     ("no state 'x'",)),
    ("limit as text", swap("(-0.6, 0.6)", "('-0.6', '0.6')"), ("Limit of input 'rudder'",)),
    ("limit of one number", swap("(-0.6, 0.6)", "0.6"), ("Limit of input 'rudder' is 0.6",)),
    ("zigzag of an unknown input", swap('Experiment("still", duration=60.0, constants={"rudder": 0.1})',
     'Experiment("z", ZigZag("helm", 0.1, 0.1), duration=60.0)'), ("no input 'helm'",)),
)  # fmt: skip
