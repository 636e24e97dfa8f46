"""What the commands print where a person reads, and where a file does."""

from __future__ import annotations

import sys

import pytest

from oed_sysid.cli.terminal import answer


@pytest.mark.parametrize(
    ("text", "terminal", "no_color", "red"),
    [
        ("DANGER: limits are left.", True, None, True),
        ("DANGER: limits are left.", True, "", True),
        ("DANGER: limits are left.", True, "1", False),
        ("DANGER: limits are left.", False, None, False),
        ("Two runs.", True, None, False),
    ],
)
def test_danger_is_red_on_a_terminal_only(
    text: str, terminal: bool, no_color: str | None, red: bool, monkeypatch, capsys
) -> None:
    """Files, pipes and readers who set NO_COLOR get the plain line, and the report stays plain."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color is not None:
        monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal, raising=False)
    answer(text, "The rest.")
    first, _, rest = capsys.readouterr().out.partition("\n")
    assert first == (f"\x1b[1;31m{text}\x1b[0m" if red else text)
    assert rest == "\nThe rest.\n"
