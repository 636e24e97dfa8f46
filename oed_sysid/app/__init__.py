"""The browser application ``oed-sysid app``: the public API with buttons.

``launch`` starts it; ``flow`` is the script that streamlit runs, ``frame`` its
frame. ``jobs`` does long work beside the page, ``tasks`` and ``plans`` say what work, and
``commands`` the same on the command line. Pages, ``frame``, ``panels`` and
``choices`` import streamlit, the others do not.
"""
