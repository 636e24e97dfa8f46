"""Stand-in for the program ``ipopt``: reads an AMPL ``.nl`` file, solves by the IPOPT of CasADi.

Pyomo calls its solvers as programs, and no package of PyPI brings this one. A
shell script named ``ipopt`` on the path that hands its arguments to
``python -m benchmarks.peers.ipopt_program`` serves instead. The solver is the
same; derivatives come from CasADi rather than from AMPL's library.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np


def main() -> int:
    """Solve ``stem.nl`` and write ``stem.sol``."""
    if "-v" in sys.argv or "--version" in sys.argv:
        print("Ipopt 3.14.0 (CasADi)")
        return 0
    stem = sys.argv[1].removesuffix(".nl")  # Pyomo leaves the suffix out
    problem = ca.NlpBuilder()
    problem.import_nl(f"{stem}.nl")
    nlp = {"x": ca.vertcat(*problem.x), "f": problem.f, "g": ca.vertcat(*problem.g)}
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    solver = ca.nlpsol("solver", "ipopt", nlp, options)
    found = solver(
        x0=problem.x_init,
        lbx=problem.x_lb,
        ubx=problem.x_ub,
        lbg=problem.g_lb,
        ubg=problem.g_ub,
    )
    solved = solver.stats()["success"]
    x, duals = np.array(found["x"]).ravel(), np.array(found["lam_g"]).ravel()
    lines = [solver.stats()["return_status"], "", "Options", "3", "1", "1", "0"]
    lines += [str(len(duals)), str(len(duals)), str(len(x)), str(len(x))]
    lines += [repr(float(v)) for v in (*-duals, *x)]
    lines += [f"objno 0 {0 if solved else 500}", ""]
    Path(f"{stem}.sol").write_text("\n".join(lines), encoding="ascii")
    return 0


if __name__ == "__main__":
    sys.exit(main())
