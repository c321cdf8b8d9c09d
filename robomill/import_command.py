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
    """Import and say what was written. LogError where mapping and log are interchanged."""
    if options.log.suffix == ".toml" != options.mapping.suffix:
        raise LogError(f"{options.mapping} is no mapping; give the mapping first, then the log: {options.log} {options.mapping}")
    done, left_out = import_log(options.mapping, options.log, options.out, options.overwrite, labels(options.label))
    if options.json:
        told = [
            {"run": str(r.folder), "rows": r.rows, "step_s": r.step, "span_s": r.span, "gap_s": r.gap, "columns": list(r.columns)}
            for r in done
        ]
        print(json.dumps(told[0] if done[0].folder == options.out else {"runs": told, "left_out": left_out}))
        return 0
    for r in done:
        arrays = dict.fromkeys(base_name(c) for c in r.columns)
        print(f"{r.folder}: {r.rows} rows, {1e3 * r.step:.6g} ms apart, {len(r.columns)} columns of {', '.join(arrays)}")
        if r.gap is not None:
            begin, end = r.gap
            print(f"{r.folder}: the log has no row for {1e3 * (end - begin):.6g} ms from {begin:.6g} s on")
    if left_out:
        print(f"left out: {left_out}")
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
