"""Measure the numbers of the documents' pages and write them.

    python -m benchmarks.documents [page ...] [--only section ...] [--write]

Without ``--write`` nothing is measured: pages are compared with the numbers kept.
"""

from __future__ import annotations

import argparse
import sys

from benchmarks.documents import measured_data, published
from benchmarks.documents.page import Page, Unfounded

PAGES = {page.name: page for page in (measured_data.PAGE, published.PAGE)}


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; return how many pages could not be written or differ."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.documents", description=__doc__)
    parser.add_argument("pages", nargs="*", metavar="page", help=", ".join(PAGES))
    parser.add_argument("--only", nargs="+", default=None, help="sections to measure, none: 'no'")
    parser.add_argument("--write", action="store_true", help="measure, and write the pages")
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.pages if name not in PAGES]:
        parser.error(f"there is no page {unknown[0]}; choose from {', '.join(PAGES)}")
    pages = [PAGES[name] for name in given.pages or PAGES]
    known = {section for page in pages for section in page.sections} | {"no"}
    if unknown := [name for name in given.only or () if name not in known]:
        parser.error(f"there is no section {unknown[0]}; choose from {', '.join(sorted(known))}")
    return sum(_worked(page, given.only, write=given.write) for page in pages)


def _worked(page: Page, only: list[str] | None, *, write: bool) -> int:
    """Measure one page's sections and write it, or compare it; 1 where that fails."""
    if write:
        for section in page.sections:
            if only is None or section in only:
                print(f"{page.name}, {section} ...", flush=True)
                print(f"  {page.measure(section)['seconds']} s", flush=True)
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
