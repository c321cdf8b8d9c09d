"""`python -m benchmarks.recordings.taken_out [NAME ...] [--page FILE]`: recordings with a law that the catalogue does not have.

Each kind of effects that a machine is known to have is taken out of the catalogue in turn: no other name may take its place. The form says
what the nominal system lacks. A coupling that no catalogue has is put into one log.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.recordings.cases import Case, cases, prepare
from benchmarks.recordings.table import NAMED, row
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.forms.instead import LITTLE
from robomill.diagnosis.forms.layout import Form
from robomill.orchestration.runs.run import Run

RECORDINGS = ("ur10", "kuka_kr300")
"""Those of robots that move: laws of motion have forms."""


@dataclass(frozen=True)
class Coupling:
    """A motor that also turns when another joint does: its torque has the friction of that."""

    recording: str
    torque: str
    """Column to which it is added."""
    speed: str
    """Column of the speed of the other joint."""
    size: float
    """N.m.s/rad"""

    @property
    def text(self) -> str:
        """As it is called in the table."""
        return f"put into the log: {self.torque} + {self.size:g} N.m.s/rad {self.speed}"

    def added(self, run: Run) -> Run:
        """The run with it."""
        return replace(run, columns={**run.columns, self.torque: run.columns[self.torque] + self.size * run.columns[self.speed]})


COUPLING = Coupling("kuka_kr300", "robot.torque_motor[5]", "motion.qd[4]", 2.0)
"""None of the recordings has one: speeds of the other joints do not predict the torques of the other trajectory. At this size it takes as
much torque as the friction of the joint itself."""


@dataclass(frozen=True)
class TakenOut:
    """An answer without the right name in the catalogue."""

    what: str
    """What is missing there; empty: nothing."""
    verdict: str
    named: dict[str, float]
    """`effect @ location` -> probability."""
    onset: str
    """When an effect began, in words; empty where none did."""
    form: Form | None
    closures: dict[tuple[str, str], float]
    """(metric, runs) -> the part of the gap that is closed."""
    cpu: float
    """s"""

    def in_its_place(self, whole: TakenOut) -> dict[str, float]:
        """Names that are likelier than not here, and were not with the `whole` catalogue."""
        return {n: p for n, p in self.named.items() if p >= NAMED > whole.named.get(n, 0.0)}

    def closes_less(self, whole: TakenOut) -> float:
        """By how much of the gap less is closed than with the `whole` catalogue, where that is most, held-out runs included; at least 0."""
        return max((0.0, *(c - self.closures.get(at, 0.0) for at, c in whole.closures.items())))


def without(case: Case, effect: str, given: Sequence[Run], held: Sequence[Run], what: str, form: bool = False) -> TakenOut:
    """The answer with all effects of this kind taken out of the catalogue; `what`: how that is called; `form`: with what is missing."""
    catalogue = case.catalogue()
    kept = replace(catalogue, candidates=tuple(c for c in catalogue.candidates if c.effect != effect))
    began = time.process_time()
    found = diagnose(case.system(), given, kept, held_out=held, resolver=resolve, convert=convert, form=form)
    named = {f"{w['effect']} @ {w['location']}": float(w["probability"]) for w in found.result.get("which", [])}
    onset = found.answer.onset.text if found.answer.onset else ""
    closures = {(h.metric, h.on): h.closure for h in found.answer.how_far if h.closure is not None}
    return TakenOut(what, found.answer.verdict, named, onset, found.answer.form, closures, time.process_time() - began)


def taken_out(case: Case, folder: Path, prepared: Path) -> list[TakenOut]:
    """The whole catalogue first, then without each kind that the machine is known to have, then with what was put into the log.

    The form is of all that is missing of the nominal system: it is the same whatever was taken out.
    """
    given, held = case.runs(folder, prepared)
    kinds = dict.fromkeys(name.partition(" @ ")[0] for name in case.expected)
    found = [without(case, "", given, held, "", form=True)]
    found += [without(case, kind, given, held, kind) for kind in kinds]
    if case.name == COUPLING.recording:
        coupled, also = ([COUPLING.added(r) for r in part] for part in (given, held))
        found.append(without(case, "", coupled, also, COUPLING.text, form=True))
    return found


def answers(found: Sequence[TakenOut]) -> list[str]:
    """Rows of a table of what was answered."""
    whole = found[0]
    lines = [row(("taken out", "verdict", "likeliest name", "names in its place", "closes less by", "CPU s")), row(["---"] * 6)]
    for f in found:
        best = max(f.named, key=lambda n: f.named[n], default="")
        likeliest = f"{best} {f.named[best]:.3f}" if best else "-"
        instead = ", ".join(f"{n} {p:.2f}" for n, p in f.in_its_place(whole).items())
        lines.append(
            row((f.what or "nothing", f.verdict, likeliest, instead or "-", f"{100.0 * f.closes_less(whole):.1f} %", f"{f.cpu:.1f}"))
        )
    return lines


def forms(found: TakenOut) -> list[str]:
    """What the form says, port by port, and how far it closes the gap."""
    assert found.form is not None
    lines = [f"- {found.what or 'as it was recorded'}: {'; '.join((*found.form.like, *filter(None, [found.form.note]))) or 'a formula'}"]
    lines += [f"  - {p.port} ({p.unit}): {p.formula}, closes {100.0 * p.closure:.0f} %" for p in found.form.ports]
    for h in found.form.how_far:
        if h.on != "diagnosed runs" and h.closure is not None and h.unit:
            lines.append(f"  - in the loop, {h.channel} rms, {h.on}: {h.before:.3g} -> {h.after:.3g} {h.unit}, {100.0 * h.closure:.0f} %")
    return lines


def text(case: Case, found: Sequence[TakenOut]) -> str:
    """The part of the page on one recording."""
    whole, *others = found
    worse = [f for f in others if f.verdict == "identified" and f.in_its_place(whole)]
    alike = [f for f in worse if f.closes_less(whole) <= LITTLE]
    sure = [f"{f.what}: {f.onset}" for f in found if f.onset]
    return "\n".join(
        [
            f"## {case.title}",
            "",
            *answers(found),
            "",
            f"With names in its place, and `identified`: {', '.join(f.what for f in worse) or 'none'}, of {len(others)}.",
            *(
                [f"Of these, as much of the gap is closed without the right names, within 2 %: {', '.join(f.what for f in alike)}."]
                if alike
                else []
            ),
            *(["Onset: " + "; ".join(sure) + "."] if sure else []),
            "",
            "The form of all that the nominal system lacks, whatever the catalogue has:",
            "",
            *(line for f in found if f.form for line in forms(f)),
            "",
        ]
    )


HEAD = """# Laws that the catalogue does not have

Written by `python -m benchmarks.recordings.taken_out --page FILE`; do not edit.

All effects of one kind that the machine is known to have are taken out of the catalogue. Then no other name may take their place with
confidence. Names in its place: likelier than not here, and not with the whole catalogue. Closes less by: the part of the gap that the
answer closes less than that with the whole catalogue, in the figure and the runs where that is most, held-out ones included. Where it is
no more than 2 %, what is left does not give the other names away. The
[form](../explanation/unknown_forms.md) says what is missing, without any name.

No recording has a wrist coupling: speeds of the other joints do not predict the torques of a trajectory that was left out. One is
put into a log, all else is as it was recorded.
"""


def main() -> int:
    """Print the page, and write it."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(RECORDINGS)}; without: all")
    options.add_argument("--page", type=Path, metavar="FILE", help="write the page there")
    given = options.parse_args()
    if wrong := [n for n in given.names if n not in RECORDINGS]:
        options.error(f"unknown recording {wrong[0]!r}; there are {', '.join(RECORDINGS)}")
    parts = [HEAD]
    with TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared"
        prepare(prepared)
        for case in cases():
            if case.name in (given.names or RECORDINGS):
                parts.append(text(case, taken_out(case, Path(folder) / case.name, prepared)))
                print(parts[-1], flush=True)
    if given.page:
        given.page.write_text("\n".join(parts), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
