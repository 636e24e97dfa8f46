"""The oldest versions of libraries that pyproject.toml admits, as constraints for pip.

    python -m benchmarks.lowest > lowest.txt
    pip install -c lowest.txt -e ".[dev]"

`make test-all` does so, and tests.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_REQUIREMENT = re.compile(r"([A-Za-z0-9_.-]+)(?:\[[^\]]*\])?\s*>=\s*([0-9][0-9a-z.]*)")


def constraints(requirements: Iterable[str]) -> list[str]:
    """Return ``name==version`` for every requirement with a lowest version.

    Parameters
    ----------
    requirements : iterable of str
        As in pyproject.toml.

    Examples
    --------
    >>> constraints(["numpy>=1.26", "oed-sysid[app]", "dask[array]>=2024.1"])
    ['numpy==1.26', 'dask==2024.1']
    """
    found = (_REQUIREMENT.fullmatch(one.strip()) for one in requirements)
    return [f"{one[1]}=={one[2]}" for one in found if one]


def lowest() -> list[str]:
    """Constraints of what an installation without extras needs."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return constraints(project["dependencies"])


if __name__ == "__main__":
    print("\n".join(lowest()))
