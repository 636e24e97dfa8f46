"""How the benchmarks measure: processor time, best of several, targets beside what was found."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import casadi
import numpy as np
import scipy


def least(work: Callable[[], object], repeats: int = 15) -> float:
    """Least processor time of several warm calls, s: what other loads on the machine leave.

    Processor time counts all threads of this process, so a call that spreads
    over threads gains nothing by it here.
    """
    work()
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        taken.append(time.process_time() - began)
    return min(taken)


def elapsed(work: Callable[[], object], repeats: int = 5) -> float:
    """Least time on the clock of several warm calls, s."""
    work()
    taken = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
    return min(taken)


def verdict(what: str, value: float, target: float, unit: str = "", *, at_most: bool = True) -> str:
    """One line: what was measured beside its target, met or MISSED."""
    met = value <= target if at_most else value >= target
    relation = "<=" if at_most else ">="
    stated = f"{value:.3g} {unit}".strip()
    return f"{what:<58} {stated:>10}   target {relation} {target:g}: {'met' if met else 'MISSED'}"


def machine() -> str:
    """Processor, load and versions: numbers mean little without them."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        pass
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return (
        f"{name}, {os.cpu_count()} cores{load}; Python {platform.python_version()}, NumPy "
        f"{np.__version__}, SciPy {scipy.__version__}, CasADi {casadi.__version__}"
    )
