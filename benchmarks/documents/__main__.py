"""Measure the numbers of the documents' pages and write them.

    python -m benchmarks.documents [page ...] [--write [--only section ...] | --kept]

With ``--write`` sections are measured and pages written; with ``--kept`` pages are written from
the numbers that were measured last; without either they are compared with these.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection

from benchmarks.documents import extrapolation, measured_data, published
from benchmarks.documents.page import Page, Unfounded

PAGES = {page.name: page for page in (measured_data.PAGE, extrapolation.PAGE, published.PAGE)}


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; return how many pages could not be written or differ."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.documents", description=__doc__)
    parser.add_argument("pages", nargs="*", metavar="page", help=", ".join(PAGES))
    parser.add_argument("--only", nargs="+", default=None, help="sections to measure")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--write", action="store_true", help="measure, and write the pages")
    how.add_argument("--kept", action="store_true", help="write from the numbers kept")
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.pages if name not in PAGES]:
        parser.error(f"there is no page {unknown[0]}; choose from {', '.join(PAGES)}")
    pages = [PAGES[name] for name in given.pages or PAGES]
    known = {section for page in pages for section in page.sections}
    if unknown := [name for name in given.only or () if name not in known]:
        parser.error(f"there is no section {unknown[0]}; choose from {', '.join(sorted(known))}")
    if given.only and not given.write:
        parser.error("--only says what --write measures")
    if given.write:
        for page in pages:
            measure(page, given.only or page.sections)
    return sum(_ended(page, write=given.write or given.kept) for page in pages)


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
    sys.exit(main())
