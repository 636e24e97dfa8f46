"""``python -m oed_sysid`` is ``oed-sysid``."""

from __future__ import annotations

from oed_sysid.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
