"""Screenshots of the built site, in docs/pictures/site: `python docs/site_pictures.py results/site` after `make docs`.

Needs Chromium. A page stands in a frame as wide as the screen it is shown for, because a window of Chromium has a least width.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

PICTURES = Path(__file__).parent / "pictures" / "site"
COLOURS = 128
"""Number of colours in a picture: text and few areas. Twice as many make the files half as large again and look the same."""
SETTLED = 3000
"""ms of virtual time until a page has laid itself out."""


@dataclass(frozen=True)
class Shot:
    """A picture of a page."""

    name: str
    page: str
    """Address below the folder of the site."""
    width: int
    height: int
    dark: bool = False


SHOTS = (
    Shot("start", "docs/index.html", 1400, 900),
    Shot("start_narrow", "docs/index.html", 400, 900, dark=True),
    Shot("tutorial", "docs/tutorials/mill_a_part.html", 1400, 900, dark=True),
    Shot("component", "docs/components/milling_force.html", 1400, 900),
    Shot("notebook", "docs/tutorials/notebooks/groove_sweep.html", 1400, 900),
    Shot("reference_narrow", "docs/reference/formats/mapping.html", 400, 900),
)


def main(site: Path) -> None:
    """Write every picture; SystemExit says what is missing."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("Chromium is not installed; install it and call this again")
    if missing := [s.page for s in SHOTS if not (site / s.page).is_file()]:
        raise SystemExit(f"{site}: there is no {', '.join(missing)}; build the site first: make docs")
    PICTURES.mkdir(parents=True, exist_ok=True)
    for shot in SHOTS:
        file = PICTURES / f"{shot.name}.png"
        with tempfile.TemporaryDirectory() as folder:
            take(chromium, (site / shot.page).resolve(), shot, file, Path(folder))
        print(f"{file}  {file.stat().st_size / 1000:.0f} kB")


def take(chromium: str, page: Path, shot: Shot, file: Path, folder: Path) -> None:
    """One picture, through a page with a frame in a folder of its own."""
    frame = f'<iframe src="{page.as_uri()}" style="border:0;width:{shot.width}px;height:{shot.height}px"></iframe>'
    (folder / "frame.html").write_text(f'<body style="margin:0">{frame}</body>', encoding="utf-8")
    command = [
        chromium,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        "--hide-scrollbars",
        f"--user-data-dir={folder / 'profile'}",
        f"--blink-settings=preferredColorScheme={0 if shot.dark else 1}",
        f"--virtual-time-budget={SETTLED}",
        f"--window-size={max(shot.width, 500)},{shot.height + 200}",
        f"--screenshot={folder / 'whole.png'}",
        (folder / "frame.html").as_uri(),
    ]
    subprocess.run(command, check=True, capture_output=True)
    with Image.open(folder / "whole.png") as whole:
        whole.convert("RGB").crop((0, 0, shot.width, shot.height)).quantize(COLOURS).save(file, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/site"))
