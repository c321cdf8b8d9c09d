"""`robomill view`: runs in space and time, as one HTML page."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

PAGE = "view.html"


def add_arguments(parser: Any) -> None:
    """What is shown, and where the page goes."""
    parser.add_argument("folder", type=Path, metavar="RUN", help="folder that robomill run wrote: of a scenario, a variant or a system")
    parser.add_argument("--out", type=Path, metavar="FILE.html", help=f"the page (default: RUN/{PAGE})")
    parser.add_argument(
        "--variant", action="append", metavar="NAME", help="only this run in the folder; may be repeated (default: the first four)"
    )
    parser.add_argument("--urdf", type=Path, metavar="FILE", help="what the robot looks like: a URDF file, its meshes as STL")
    parser.add_argument("--overwrite", action="store_true", help="replace the page if it is there (default: that is refused)")


def run(options: Namespace) -> int:
    """Write the page; say where it is, how large, and what is not shown."""
    file = options.out or options.folder / PAGE
    if file.exists() and not options.overwrite:
        raise FileExistsError(f"{file} is there already; choose another file (--out), or allow overwriting (--overwrite)")
    if file.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"--out {file}: expected a name that ends in .html")
    from robomill.viewer import view

    written = view(options.folder, file, options.variant, options.urdf)
    size = file.stat().st_size
    if options.json:
        print(json.dumps({"file": str(file), "bytes": size, "runs": list(written.runs), "notes": list(written.notes)}))
        return 0
    for text in written.notes:
        print(f"note: {text}", file=sys.stderr)
    print(f"{file}: {', '.join(written.runs)}; {1e-6 * size:.1f} MB; open it in a browser, it needs no network")
    return 0
