"""Measure the numbers of the documents' pages and write them.

    python -m benchmarks.documents [page ...] [--write [--only section ...] | --kept]

With ``--write`` sections are measured and pages written; with ``--kept`` pages are written from
the numbers that were measured last; without either they are compared with these.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence

from benchmarks.documents import (
    check,
    estimation,
    extrapolation,
    measured_data,
    performance,
    published,
    reliability,
)
from benchmarks.documents.page import Page, Unfounded
from benchmarks.harness import command, known

PAGES = {
    one.PAGE.name: one.PAGE
    for one in (
        measured_data,
        extrapolation,
        published,
        estimation,
        performance,
        check,
        reliability,
    )
}


def main(
    pages: Sequence[str] = (), *, only: Sequence[str] = (), write: bool = False, kept: bool = False
) -> int:
    """Measure and write; return how many pages could not be written or differ.

    Parameters
    ----------
    pages : sequence of str
        those that are measured here; all without a name
    only : sequence of str
        sections that --write measures
    write : bool
        measure, and write the pages
    kept : bool
        write from the numbers kept
    """
    chosen = [PAGES[known(name, PAGES, "page")] for name in pages or PAGES]
    sections = [section for page in chosen for section in page.sections]
    if only and not write:
        raise SystemExit("--only says what --write measures")
    wanted = [known(name, sections, "section") for name in only] or sections
    for page in chosen if write else ():
        measure(page, wanted)
    return sum(_ended(page, write=write or kept) for page in chosen)


def measure(page: Page, sections: Collection[str]) -> None:
    """Measure these sections of a page, in its order."""
    for section in page.sections:
        if section in sections:
            print(f"{page.name}, {section} ...", flush=True)
            print(f"  {page.measure(section)['seconds']} s", flush=True)


def _ended(page: Page, *, write: bool) -> int:
    """Write one page from the numbers kept, or compare it; 1 where that fails."""
    try:
        text = page.text()
    except Unfounded as error:
        print(f"{page.target.name}: {error}", file=sys.stderr)
        return 1
    if write:
        page.target.write_text(text, encoding="utf-8")
        print(f"{page.target} is written.")
        return 0
    same = page.target.read_text(encoding="utf-8") == text
    print(f"{page.target}: {'as measured' if same else 'differs from what was measured'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(command(main))
