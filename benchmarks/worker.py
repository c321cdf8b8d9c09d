"""A master in a process of its own: `python -m benchmarks.worker KIND FILE` answers requests, lines of JSON.

So a master that crashes or hangs costs its rows in the tables and no more, memory is that of one master, and all of them can take turns.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any


def make(kind: str, file: Path) -> Any:
    """The master of that kind on the system (ours) or network (peers) in the file; only its own libraries are loaded."""
    if kind in ("compiled", "python"):
        from benchmarks.ours import Ours

        return Ours(file, kind)
    from benchmarks import peers

    return {"fmpy": peers.Fmpy, "fmpy-buffers": peers.FmpyBuffers, "libcosim": peers.Cosim, "ecos": peers.Ecos}[kind](file)


def main() -> None:
    """Answer until the requests end."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    master = None
    for line in sys.stdin:
        try:
            master = master or make(sys.argv[1], Path(sys.argv[2]))
            answer = asdict(master.run(**json.loads(line)))
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
