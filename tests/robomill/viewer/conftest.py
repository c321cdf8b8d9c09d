"""A short run in two variants."""

from pathlib import Path

import pytest

from robomill.cli import main
from tests import SCENARIOS


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a slot of 20 mm through the corner of a small block, without and with compensation."""
    folder = tmp_path_factory.mktemp("viewer")
    (folder / "milling_cell.toml").write_text((SCENARIOS / "milling_cell.toml").read_text())
    (folder / "slot.ngc").write_text("G21 G90 G17 G54\nT1 M6\nS13000 M3\nG0 X-20. Y0. Z2.\nG1 Z-5. F1500.\nX0.\nG0 Z2.\nM30\n")
    (folder / "slot.toml").write_text(
        '[scenario]\nname = "slot"\nkind = "milling"\nsystem = "milling_cell.toml"\nprogram = "slot.ngc"\n'
        '[workpiece]\nposition = ["1300 mm", 0, "1.2 m"]\nabc = ["180 deg", 0, 0]\nsize = ["20 mm", "40 mm", "10 mm"]\n'
        "[variants.uncompensated]\nparameters.controller.mode = 0\n[variants.cartesian]\nparameters.controller.mode = 1\n"
    )
    assert main(["run", str(folder / "slot.toml"), "--out", str(folder / "results" / "slot"), "--no-pictures"]) == 0
    return folder / "results" / "slot"
