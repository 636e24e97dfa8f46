"""``python -m oed_sysid.cli`` is ``oed-sysid``."""

from __future__ import annotations

import sys

from oed_sysid.cli import main

sys.exit(main())
