"""The page: its numbers are those of the run, it needs nothing from outside, and a browser shows what was recorded."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.cli import main
from robomill.viewer import view
from robomill.viewer.recorded import Recorded, recordings
from robomill.viewer.stock import cut_stock
from tests import ROOT
from tests.robomill.viewer.test_stock import heights
from tests.robomill.viewer.test_urdf import urdf
from tests.tolerances import EXACT

SINGLE = 1e-6
"""Relative: the page has single precision."""
CUBIC_MM = 1e-3
"""cm3: the page says what is cut with three digits."""
WHOLE, HUNDREDTHS = 0.5 + 1e-6, 0.005 + 1e-6
"""Half of the last digit that is shown, of newtons and millimetres, and single precision."""
BETWEEN = 0.02
"""mm: the tree bends to first order, and between samples its angles are interpolated, not the place of the tool."""
MADE = ROOT / "robomill" / "viewer"


@pytest.fixture(scope="module")
def page(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "view.html"
    assert view(results, file).runs == ("uncompensated", "cartesian")
    return file


def scene(page: Path) -> tuple[dict[str, Any], bytes]:
    text = page.read_text()
    found = {i: text.partition(f'id="{i}">')[2].partition("</script>")[0] for i in ("scene", "data")}
    return json.loads(found["scene"]), zlib.decompress(base64.b64decode(found["data"]))


def values(packed: dict[str, Any], data: bytes) -> np.ndarray:
    return np.frombuffer(data, "<" + packed["type"], packed["n"], packed["at"])


def test_the_numbers_are_those_of_the_run(page: Path, results: Path) -> None:
    said, data = scene(page)
    for variant, r in zip(said["variants"], recordings(results, None)[0], strict=True):
        for name, want in (("tip", r.p), ("force", r.f), ("q", r.q), ("t", r.run.t[r.kept])):
            assert want is not None
            assert values(variant[name], data) == pytest.approx(want.ravel(), rel=SINGLE, abs=SINGLE)
        largest = 1e3 * np.abs(values(variant["patches"]["deviation"], data)).max()
        assert largest == pytest.approx(
            1e3 * json.loads((results / "summary.json").read_text())["variants"][r.name]["max_deviation_m"], rel=SINGLE
        )


def test_it_is_one_file_that_asks_the_network_for_nothing(page: Path) -> None:
    text = page.read_text()
    assert "default-src 'none'" in text  # the browser refuses what is asked for all the same
    assert not re.findall(
        r"<(?:script|img|iframe)[^>]*\ssrc=|<link\b|@import|url\(", text.replace(MADE.joinpath("three/three.min.js").read_text(), "")
    )
    assert "{{" not in text.replace(MADE.joinpath("three/three.min.js").read_text(), "")
    assert "The MIT License" in MADE.joinpath("three/LICENSE").read_text()


def test_names_cannot_end_the_script(results: Path, tmp_path: Path) -> None:
    copy = tmp_path / "a&b"
    shutil.copytree(results / "cartesian", copy / "<!-- x")
    view(copy, tmp_path / "view.html")
    text = (tmp_path / "view.html").read_text()
    assert "<title>a&amp;b" in text
    assert scene(tmp_path / "view.html")[0]["variants"][0]["name"] == "<!-- x"
    assert "<!-- x" not in text


def test_the_command_says_what_it_wrote_and_replaces_nothing(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "slot"
    shutil.copytree(results, folder)
    assert main(["view", str(folder), "--variant", "cartesian"]) == 0
    assert re.search(r"view.html: cartesian; \d.\d MB; open it in a browser, it needs no network", capsys.readouterr().out)
    before = (folder / "view.html").read_bytes()
    assert main(["view", str(folder)]) == 2
    assert "view.html is there already; choose another file (--out), or allow overwriting (--overwrite)" in capsys.readouterr().err
    assert (folder / "view.html").read_bytes() == before
    (folder / "diagnosis").mkdir()
    (folder / "diagnosis" / "report.html").write_text("")
    assert main(["view", str(folder), "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["runs"] == ["uncompensated", "cartesian"]
    assert scene(folder / "view.html")[0]["report"] == "diagnosis/report.html"
    assert main(["view", str(folder), "--out", str(tmp_path / "page.png")]) == 2
    assert "expected a name that ends in .html" in capsys.readouterr().err


def test_a_robot_of_ones_own(results: Path, tmp_path: Path) -> None:
    file = tmp_path / "kr.urdf"
    file.write_text(urdf())
    assert view(results, tmp_path / "a.html", ["cartesian"], file).notes == ()
    said, data = scene(tmp_path / "a.html")
    assert len(said["urdf"]["bodies"]) == 6
    assert values(said["urdf"]["bodies"][0]["triangles"], data).size == 36
    file.write_text(urdf().replace("<axis xyz='0 0 1'/>", "<axis xyz='0 0 -1'/>", 1))
    (note,) = view(results, tmp_path / "b.html", ["cartesian"], file).notes
    other = r"cartesian: the sixth link of the URDF shifts by \d+ mm and turns by [\d.]+ deg against the flange"
    assert re.match(other, note)
    sixth = re.search(r"<joint name='joint_6'.*?<axis xyz='0 0 (-?1)'/>", urdf())
    assert sixth is not None
    turned = sixth[0].replace(f"0 0 {sixth[1]}'/>", f"0 0 {-int(sixth[1])}'/>")
    file.write_text(urdf().replace(sixth[0], turned))  # the flange stays where it is, and turns the other way
    (note,) = view(results, tmp_path / "c.html", ["cartesian"], file).notes
    assert re.match(other, note)


FRAMES = "<head><script>window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 16);</script>"
"""A browser without a screen draws no frames of its own."""
PROBE = """<script>
const shown = [];
const look = (t, more) => new Promise((next) => {
  const slider = document.getElementById("time");
  slider.value = t; slider.oninput(); more?.();
  requestAnimationFrame(() => requestAnimationFrame(() => {
    const pane = document.querySelector(".pane");
    shown.push([+slider.value, pane.dataset.tip, pane.dataset.removed, pane.querySelector(".said").textContent]); next();
  }));
});
const wait = setInterval(async () => {
  const state = document.documentElement.dataset.state;
  if (!state) return;
  clearInterval(wait);
  for (const t of TIMES) await look(t);
  await look(TIMES[0], () => { const f = document.getElementById("factor"); f.value = 1; f.oninput(); });
  document.body.replaceChildren(Object.assign(document.createElement("pre"), { id: "found", textContent: state + JSON.stringify(shown) }));
}, 50);
</script></body>"""


@pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed")
def test_a_browser_shows_what_was_recorded_at_every_time(page: Path, results: Path, tmp_path: Path) -> None:
    r = recordings(results, ["uncompensated"])[0][0]
    end = float(r.run.t[-1])
    between = 0.5 * float(r.run.t[1] - r.run.t[0])  # times of the page are of single precision: not at a sample
    times = [0.6 * end + between, end, 0.3 * end + between, 0.0, 0.6 * end + between]  # forwards and backwards
    probe = tmp_path / "probe.html"
    text = page.read_text().replace("<head>", FRAMES, 1)
    probe.write_text(text.replace("</body>", PROBE.replace("TIMES", json.dumps(times))))
    command = ["chromium", "--headless", "--no-sandbox", "--disable-background-networking", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=500,400"]
    command += ["--virtual-time-budget=6000", "--dump-dom", probe.as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=240, check=True).stdout
    found = re.search(r'<pre id="found">(\w+)(.*?)</pre>', dom)
    assert found is not None
    assert found[1] == "ready"
    shown = json.loads(found[2])
    workpiece = r.workpiece()
    assert workpiece is not None
    stock = cut_stock(r, workpiece)
    for t, tip, removed, text in shown[:-1]:
        at = int(np.searchsorted(r.run.t[r.kept].astype(np.float32), t, side="right")) - 1
        _agree(r, t, tip, text)
        gone = 1e6 * np.prod(stock.high[:2] - stock.low[:2]) * float(np.mean(heights(stock, 0) - heights(stock, at)))
        assert float(removed) == pytest.approx(gone, rel=SINGLE, abs=CUBIC_MM)
    assert shown[0] == shown[4]
    # magnified 500 times the tool is 500 times as far from where the axes put it: first order in a bending of millimetres
    moved = np.array(shown[5][1].split(), dtype=float) - np.array(shown[0][1].split(), dtype=float)
    assert np.linalg.norm(moved) > 100.0


def _agree(r: Recorded, t: float, tip: str, text: str) -> None:
    """Tool of the robot's tree, force and deviation in words, at a time."""

    def at(columns: np.ndarray | None) -> np.ndarray:
        assert columns is not None
        return np.array([np.interp(t, r.run.t[r.kept], c) for c in columns.T])

    assert np.array(tip.split(), dtype=float) == pytest.approx(1e3 * at(r.p), rel=EXACT, abs=BETWEEN)
    words = re.search(r"uncompensated (\d+) N · tool ([\d.]+) mm off · part up to ([\d.]+) mm", text)
    assert words is not None
    assert float(words[1]) == pytest.approx(float(np.linalg.norm(at(r.f))), rel=EXACT, abs=WHOLE)
    assert float(words[2]) == pytest.approx(1e3 * float(np.linalg.norm(at(r.across))), rel=EXACT, abs=HUNDREDTHS)
