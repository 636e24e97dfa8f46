"""The script that ``streamlit run`` executes, once per click."""

from __future__ import annotations

import sys

from oed_sysid.app.frame import show

if __name__ == "__main__":
    show(sys.argv[1] if len(sys.argv) > 1 else None)
