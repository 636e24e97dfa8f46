"""Stand-in for the program ``ipopt``: reads an AMPL ``.nl`` file, solves by the IPOPT of CasADi.

Pyomo calls its solvers as programs, and no package of PyPI brings this one. The script ``ipopt`` in
this folder, last on the path of a peer, hands its arguments on to here. The solver is the same;
derivatives come from CasADi rather than from AMPL's library.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np

# What AMPL's solvers answer; with the code of a limit the last iterate is still read.
CODES = {
    "Solve_Succeeded": 0,
    "Solved_To_Acceptable_Level": 0,
    "Infeasible_Problem_Detected": 200,
    "Maximum_Iterations_Exceeded": 400,
}


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def main() -> int:
    """Solve ``stem.nl`` and write ``stem.sol``."""
    if "-v" in sys.argv or "--version" in sys.argv:
        print("Ipopt 3.14.0 (CasADi)")
        return 0
    stem = sys.argv[1].removesuffix(".nl")  # Pyomo leaves the suffix out
    problem = ca.NlpBuilder()
    problem.import_nl(f"{stem}.nl")
    nlp = {"x": ca.vertcat(*problem.x), "f": problem.f, "g": ca.vertcat(*problem.g)}
    # Expanded, so that derivatives cost little beside the linear algebra, as with AMPL's library.
    options = {"print_time": False, "expand": True, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    for word in sys.argv[2:]:  # as Pyomo passes its options: max_iter=300
        name, _, value = word.partition("=")
        if value:
            options[f"ipopt.{name}"] = _number(value)
    solver = ca.nlpsol("solver", "ipopt", nlp, options)
    found = solver(
        x0=problem.x_init,
        lbx=problem.x_lb,
        ubx=problem.x_ub,
        lbg=problem.g_lb,
        ubg=problem.g_ub,
    )
    status = solver.stats()["return_status"]
    x, duals = np.array(found["x"]).ravel(), np.array(found["lam_g"]).ravel()
    lines = [status, "", "Options", "3", "1", "1", "0"]
    lines += [str(len(duals)), str(len(duals)), str(len(x)), str(len(x))]
    lines += [repr(float(v)) for v in (*-duals, *x)]
    lines += [f"objno 0 {CODES.get(status, 500)}", ""]
    Path(f"{stem}.sol").write_text("\n".join(lines), encoding="ascii")
    return 0


if __name__ == "__main__":
    sys.exit(main())
