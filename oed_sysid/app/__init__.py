"""The browser application ``oed-sysid app``: the public API with buttons.

``launch`` starts it; ``flow`` is the script that streamlit runs, ``frame`` its
frame. ``jobs`` does long work beside the page, ``tasks`` says what work, and
``commands`` the same on the command line. Only ``launch``, ``jobs``, ``tasks``,
``commands`` and ``records`` can be imported without streamlit.
"""
