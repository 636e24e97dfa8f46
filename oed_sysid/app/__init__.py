"""The browser application ``oed-sysid app``: the tasks of :mod:`oed_sysid.cli.tasks` with buttons.

``launch`` starts it; ``frame`` is the script that streamlit runs. A page asks for the options of
a task by their rows, ``jobs`` does the work in a process of its own, and what is shown is the
document of the result. All but ``jobs``, ``launch`` and ``trust`` import streamlit.
"""
