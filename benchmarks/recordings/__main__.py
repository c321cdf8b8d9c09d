"""`python -m benchmarks.recordings [NAME ...] [--json FILE] [--pages FOLDER]`: the diagnosis on the public recordings."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.recordings import page, table
from benchmarks.recordings.cases import cases, prepare
from benchmarks.recordings.measure import measured


def main() -> int:
    """Diagnose them one after the other and print tables; with --pages, write a page of each."""
    known = {c.name: c for c in cases()}
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(known)}; without: all")
    options.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    options.add_argument("--pages", type=Path, metavar="FOLDER", help="write a page of each recording there")
    given = options.parse_args()
    if wrong := [n for n in given.names if n not in known]:
        options.error(f"unknown recording {wrong[0]!r}; there are {', '.join(known)}")
    outcomes = []
    with TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared"
        prepare(prepared)
        for case in [known[n] for n in given.names] or list(known.values()):
            outcome = measured(case, Path(folder) / case.name, prepared)
            outcomes.append(outcome)
            print(table.of(case, outcome), flush=True)
            if given.pages:
                page.write(case, outcome, given.pages)
    print(table.summary(outcomes))
    if given.json:
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps([o.json() for o in outcomes], indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
