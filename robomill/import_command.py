"""`robomill import`: a foreign log becomes a run folder."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterable

from robomill.logs.importing import import_log
from robomill.logs.reading import LogError
from robomill.orchestration.slaves.protocol import base_name

Label = bool | int | float | str


def run(options: Namespace) -> int:
    """Import and say what was written."""
    done = import_log(options.mapping, options.log, options.out, options.overwrite, labels(options.label))
    if options.json:
        print(json.dumps({"run": str(done.folder), "rows": done.rows, "step_s": done.step, "columns": list(done.columns)}))
    else:
        arrays = dict.fromkeys(base_name(c) for c in done.columns)
        print(f"{done.folder}: {done.rows} rows, {1e3 * done.step:.6g} ms apart, {len(done.columns)} columns of {', '.join(arrays)}")
    return 0


def labels(texts: Iterable[str]) -> dict[str, Label]:
    """`key=value` texts; true, false and numbers become what they look like. LogError for a text without `=`."""
    found: dict[str, Label] = {}
    for text in texts:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise LogError(f"--label {text!r}: expected KEY=VALUE, such as held_out=true")
        found[key] = _value(value)
    return found


def _value(text: str) -> Label:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
