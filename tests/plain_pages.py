"""Pages for tests that read them: their pictures are drawn, but not laid out first."""

from __future__ import annotations

from typing import Any

import pytest

from oed_sysid.results.page import Picture


@pytest.fixture(autouse=True, scope="module")
def plain_pages():  # type: ignore[no-untyped-def]
    """Half of the time of a page is where matplotlib puts its axes; `test_report` looks at that."""
    usual = Picture.of

    def at_once(drawing: Any, *words: Any) -> Picture:
        drawing.set_layout_engine("none")
        return usual(drawing, *words)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Picture, "of", staticmethod(at_once))
        yield
