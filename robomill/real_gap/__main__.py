"""`make diagnose-real`: the study of the recorded KR 300, as real_gap.md and real_gap.json (the keys of a diagnosis) with pictures.

Needs the two recordings in data/kuka_kr300_recordings and about two minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from robomill.real_gap import page
from robomill.real_gap.study import diagnose


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("docs") / "recordings",
        help="folder for real_gap.md, real_gap.json and pictures (default: %(default)s)",
    )
    parser.add_argument("--runs", type=Path, default=Path("results") / "real_gap", help="folder for the imported runs")
    options = parser.parse_args(arguments)
    result = diagnose(options.runs)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "real_gap.json").write_text(json.dumps(page.as_json(result), indent=1) + "\n", encoding="utf-8")
    pictures = page.draw(result, options.out / "pictures")
    (options.out / "real_gap.md").write_text(page.page(result, pictures), encoding="utf-8")
    print(f"{options.out / 'real_gap.md'}, {options.out / 'real_gap.json'} and {len(pictures)} pictures are written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
