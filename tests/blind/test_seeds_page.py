"""The page of all scored seeds says what the page of each seed says."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).parent.parent.parent / "docs" / "benchmarks"
FIGURES = {
    "withheld: right": ("withheld_unknown_or_equivalent", "withheld"),
    "withheld: wrong name": ("withheld_confident_wrong", "withheld"),
    "null: alarm": ("null_false_alarm", "null"),
    "single: detected": ("detection", "single"),
    "single: named": ("effect_top1", "single"),
    "single: false unknown": ("false_unknown", "single"),
    "machine: found": ("machine_found", "machine"),
    "machine: true": ("machine_true", "machine"),
    "machine: closure": ("machine_closure_over_ceiling_median", "machine"),
    "campaign: placed": ("stiffness_placed", "campaign"),
    "bad log: stopped": ("bad_log_stopped", "bad_log"),
    "form: closure": ("form_closure_over_ceiling_median", "formed"),
    "ece": ("ece", "all sets"),
}
MEDIANS = {"machine: closure", "form: closure", "ece"}
"""Columns that are no shares of cases: they have no sum."""


def table() -> list[dict[str, str]]:
    """Rows of the page, by column."""
    rows = [line.strip("|").split("|") for line in (FOLDER / "blind_seeds.md").read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    head, _, *body = [[cell.strip() for cell in row] for row in rows]
    return [dict(zip(head, row, strict=True)) for row in body]


def test_every_page_of_a_seed_has_its_row_with_its_figures() -> None:
    rows = {m[1]: row for row in table() if (m := re.fullmatch(r"\[\d+\]\((blind[_\d]*\.md)\)", row["seed"]))}
    assert set(rows) == {p.name for p in FOLDER.glob("blind*.md")} - {"blind_seeds.md"}
    for name, row in rows.items():
        page = (FOLDER / name).read_text(encoding="utf-8")
        assert row["engine"] in page
        for column, (figure, of) in FIGURES.items():
            found = re.search(rf"^\| {figure} \| {of} \| T1 \| ([^|]*) \| [^|]* \| (\d+) \|", page, re.MULTILINE)
            assert row[column] == (f"{found[1].strip()} ({found[2]})" if found and found[1].strip() else "")


def test_the_last_row_counts_all_of_them() -> None:
    *seeds, every = [row for row in table() if row["seed"] != "*asked for*"]
    for column in FIGURES.keys() - MEDIANS:
        cases = [(float(m[1]), int(m[2])) for row in seeds if (m := re.fullmatch(r"([\d.]+) \((\d+)\)", row[column]))]
        assert every[column] == f"{sum(round(share * n) for share, n in cases)} of {sum(n for _, n in cases)}"
