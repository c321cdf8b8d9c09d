"""Write the golden results anew: ``python -m tests.fmus.regenerate [--inputs] [component ...]``. Review the diff before it is kept."""

from __future__ import annotations

import argparse
import json

import numpy as np

from robomill.fmus.components import COMPONENTS, NAMES
from robomill.fmus.interface import Interface
from tests.fmus import golden
from tests.fmus.stimuli import input_rows, stimulus


def regenerate(name: str, inputs: bool) -> list[str]:
    """Write the files of one component; returns the names of those that changed. `inputs`: in.csv and parameters.json, too."""
    folder = golden.FOLDER / name
    folder.mkdir(exist_ok=True)
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    interface = Interface(COMPONENTS[name])
    if inputs or "in.csv" not in before:
        columns, parameters = stimulus(name)
        golden.write(folder / "in.csv", interface.inputs, input_rows(interface, columns))
        for table in [n for n, v in parameters.items() if isinstance(v, np.ndarray)]:
            np.save(folder / f"{table}.npy", parameters[table])
            parameters[table] = f"{table}.npy"
        (folder / "parameters.json").write_text(json.dumps(_by_element(interface, parameters), indent=1) + "\n", encoding="utf-8")
    rows = golden.read(folder / "in.csv", interface.inputs)
    out = golden.run(interface.model, rows, golden.parameters(folder), plain=True)
    golden.write(folder / "out.csv", interface.outputs, out)
    (folder / "interface.txt").write_text(golden.interface_text(interface), encoding="utf-8")
    return sorted(f.name for f in folder.iterdir() if before.get(f.name) != f.read_bytes())


def _by_element(interface: Interface, parameters: dict[str, object]) -> dict[str, object]:
    """Arrays taken apart, as any importer can set them."""
    result: dict[str, object] = {}
    for name, value in parameters.items():
        if isinstance(value, list):
            ports = interface.parameters[interface.arrays[name]]
            result |= {p.name: v for p, v in zip(ports, value, strict=True)}
        else:
            result[name] = value
    return result


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("component", nargs="*", help=f"of {', '.join(NAMES)}; all if none is given")
    parser.add_argument("--inputs", action="store_true", help="write in.csv and parameters.json from tests/fmus/stimuli.py, too")
    options = parser.parse_args()
    unknown = sorted(set(options.component) - set(COMPONENTS))
    if unknown:
        parser.error(f"unknown component {', '.join(unknown)}; available: {', '.join(COMPONENTS)}")
    for name in options.component or COMPONENTS:
        changed = regenerate(name, options.inputs)
        print(f"{name}: {', '.join(changed) if changed else 'unchanged'}")


if __name__ == "__main__":
    main()
