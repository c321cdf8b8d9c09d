"""An interrupted diagnosis goes on where it was, and comes to the same answer."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.store import Store
from robomill.orchestration.system.definition import Component
from tests.diagnosis.demo import SYSTEM, catalogue, measure, resolve

STIFF = {"masses": {"stiffness_error[2]": -0.08}}


def answer(folder: Path, **more: Any) -> dict[str, Any]:
    return diagnose(SYSTEM, measure(STIFF), catalogue(folder), resolver=resolve, **more).result


def interrupted(folder: Path, after: int, **more: Any) -> None:
    """A diagnosis that ends with Ctrl-C after so many simulations."""
    seen = 0

    def report(what: str, done: int, total: int) -> None:
        nonlocal seen
        seen += what != "diagnosis"
        if seen == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer(folder, report=report, **more)


@pytest.mark.parametrize("workers", [1, 2])
def test_after_an_interruption_it_goes_on_and_comes_to_the_same_answer(tmp_path: Path, workers: int) -> None:
    whole = answer(tmp_path)
    store = Store(tmp_path / "kept", "program 1")
    interrupted(tmp_path, 12, store=store, workers=workers)
    assert len(store) == 12
    resumed = answer(tmp_path, store=store, workers=workers)
    effort, alone = resumed.pop("effort"), whole.pop("effort")
    assert (effort["taken_over"], alone["taken_over"]) == (12, 0)
    assert effort["simulations"] == alone["simulations"] - 12
    assert resumed == whole
    store.remove()
    assert not store.folder.exists()


def test_simulations_of_another_program_or_system_are_not_used(tmp_path: Path) -> None:
    store = Store(tmp_path / "kept", "program 1")
    interrupted(tmp_path, 5, store=store)
    assert answer(tmp_path, store=replace(store, sources="program 2"))["effort"]["taken_over"] == 0
    stiffer = SYSTEM.with_parameters("masses", {"damping": 2.2})
    other = diagnose(stiffer, measure(STIFF), catalogue(tmp_path), resolver=resolve, store=store).result
    assert other["effort"]["taken_over"] == 0


def test_a_file_counts_by_what_is_in_it_and_a_broken_one_as_missing(tmp_path: Path) -> None:
    store = Store(tmp_path / "kept")
    table = tmp_path / "program.txt"
    keys = []
    for text in ("a", "b", "a"):
        table.write_text(text)
        keys.append(store.key({"program": str(table)}, 3))
    assert keys[0] == keys[2] != keys[1]
    values = np.array([[1.0, 2.5]])
    store.put(keys[0], values)
    store.put(keys[1], None)
    there, kept = store.get(keys[0])
    assert there
    np.testing.assert_array_equal(kept, values)
    assert store.get(keys[1]) == (True, None)
    (store.folder / f"{keys[0]}.npy").write_bytes(b"half a")
    assert store.get(keys[0]) == (False, None)
    assert store.get("never") == (False, None)


def test_progress_is_told_with_what_is_to_come(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []

    def report(what: str, done: int, total: int) -> None:
        if what == "diagnosis":
            told.append((done, total))

    answer(tmp_path, report=report)
    done = [d for d, _ in told]
    assert done == sorted(done)
    assert all(d <= total for d, total in told)
    assert told[0][1] > 5 * told[0][0]


def test_a_text_of_any_length_can_be_in_a_key(tmp_path: Path) -> None:
    """A parameter is a file if there is one of its name; a name may have 255 characters, a path 4095."""
    (tmp_path / "table").write_text("1")
    system = replace(SYSTEM, file=tmp_path / "system.toml")
    texts = ["table", "chair", *("x" * n for n in (300, 3000, 5000))]
    keys = {Store(tmp_path).key(system.with_parameters("force", {"table": text})) for text in texts}
    assert len(keys) == len(texts)


OTHER: dict[str, Any] = {
    "source": "other",
    "parameters": {"damping": 2.2},
    "isolate": True,
    "rate": 2,
    "every": 2,
    "inputs": {"f": 1.0},
    "correction": "form.json",
}
"""A component that does something else."""
SAME = {"name", "line", "time_limit"}
"""What a component is called, where that stands, and how long one waits for it: nothing that a simulation depends on."""


def test_all_that_a_simulation_depends_on_is_in_a_key(tmp_path: Path) -> None:
    """A form that is put into the loop counts by what is in its file."""
    assert {f.name for f in fields(Component)} == OTHER.keys() | SAME
    store, one = Store(tmp_path, "program 1"), SYSTEM.components[0]
    keys = [store.key(replace(SYSTEM, components=(replace(one, **{name: value}),))) for name, value in OTHER.items()]
    form = tmp_path / "form.json"
    for text in ("one", "two"):
        form.write_text(text)
        keys.append(store.key(SYSTEM.with_correction(one.name, str(form))))
    assert len({*keys, store.key(SYSTEM)}) == len(keys) + 1
