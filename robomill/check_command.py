"""`robomill check`: the conformance battery on FMUs, as a table."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import asdict

from robomill.progress import progress_bar
from robomill.tables import Content, Heading, say, show


def run(options: Namespace) -> int:
    """`robomill check`: the conformance battery on each FMU; status 1 if a check failed."""
    from rich.text import Text

    from robomill import conformance

    reports: dict[str, list[conformance.Result]] = {}
    with progress_bar(options.json) as report:
        for i, fmu in enumerate(options.fmus):
            report(f"check {fmu.name}", i, len(options.fmus))
            reports[str(fmu)] = conformance.check_fmu(fmu)
        report("check", len(options.fmus), len(options.fmus))
    failed = sum(not r.passed for results in reports.values() for r in results)
    if options.json:
        print(json.dumps({name: [asdict(r) for r in results] for name, results in reports.items()}, indent=1))
        return 1 if failed else 0
    colour = {"passed": "green", "failed": "red", "finding": "yellow", "skipped": "cyan"}
    for name, results in reports.items():
        rows: list[list[Content]] = [[r.check, Text(r.outcome, style=colour[r.outcome]), r.detail] for r in results]
        show(name, [Heading("check", "left"), Heading("outcome", "left"), Heading("detail", "left", folds=True)], rows)
    say(f"{failed} checks failed" if failed else "no check failed")
    return 1 if failed else 0
