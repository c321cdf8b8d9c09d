"""Specification of windows and repeats: where pieces begin and end, what is left out, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from robomill import cli
from robomill.logs.importing import import_log
from robomill.orchestration.errors import ResultsError
from robomill.orchestration.runs.run import Run
from tests.robomill.logs.foreign import bring, refused
from tests.tolerances import ROUNDOFF

H = 0.25
ROWS = 40
HEAD = '[clock]\ncolumn = "t"\nunit = "s"\n[[signal]]\nport = "a.x"\ncolumn = "x"\nunit = "m"\n'


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """10 s at 4 Hz: x counts rows; trigger is high in the second half of every 2 s; phase and cycle are stretches; noisy is 0 to 5 V."""
    rows = ["t,x,trigger,phase,cycle,noisy"]
    for k in range(ROWS):
        high = k % 8 >= 4
        phase = ["start", "cut", "back", "cut"][k // 10]
        rows.append(f"{H * k},{k},{'true' if high else 'false'},{phase},{1 + k // 8},{(4.9 if high else 0.1) + 0.01 * (k % 3)}")
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return tmp_path / "log.csv"


def pieces(folder: Path, cut: str, log: Path, head: str = HEAD) -> list[tuple[int, int]]:
    """First and last row of each repeat."""
    bring(folder, f"[cut]\n{cut}\n{head}", log, "run/repeat_1")
    runs = [Run.load(folder / "run" / f"repeat_{k + 1}") for k in range(len(list((folder / "run").iterdir())))]
    for k, run in enumerate(runs, 1):
        assert abs(run.t[0]) <= ROUNDOFF, "the time of a repeat begins at zero"
        assert np.abs(np.diff(run.t) - H).max() <= ROUNDOFF
        assert run.info["labels"]["repeat"] == k
    return [(round(r["a.x"][0]), round(r["a.x"][-1])) for r in runs]


@pytest.mark.parametrize(
    ("cut", "rows"),
    [
        ('from = "2 s"', (8, 39)),
        ('to = "2 s"', (0, 7)),
        ('from = "1.5 s"\nto = "2500 ms"', (6, 9)),
        ('from = "-1 s"\nto = "1 min"', (0, 39)),
    ],
)
def test_a_window_keeps_its_time_and_has_its_begin_but_not_its_end(tmp_path: Path, log: Path, cut: str, rows: tuple[int, int]) -> None:
    run = bring(tmp_path, f"[cut]\n{cut}\n{HEAD}", log)
    assert (round(run["a.x"][0]), round(run["a.x"][-1])) == rows
    assert np.abs(run.t - H * run["a.x"]).max() <= ROUNDOFF


@pytest.mark.parametrize(
    ("cut", "expected"),
    [
        ('period = "2 s"', [(0, 7), (8, 15), (16, 23), (24, 31), (32, 39)]),
        ('period = "3 s"', [(0, 11), (12, 23), (24, 35)]),
        ('from = "1 s"\nto = "6 s"\nperiod = "2 s"', [(4, 11), (12, 19)]),
        ('at = ["1 s", "2 s", "7 s"]', [(4, 7), (8, 27), (28, 39)]),
        ('at = ["1 s", "2 s", "7 s"]\nlength = "2 s"', [(8, 15), (28, 35)]),
        ('marker = "trigger"', [(4, 11), (12, 19), (20, 27), (28, 35), (36, 39)]),
        ('marker = "trigger"\nwhen = "falls"', [(8, 15), (16, 23), (24, 31), (32, 39)]),
        ('marker = "trigger"\nwhile = true', [(4, 7), (12, 15), (20, 23), (28, 31), (36, 39)]),
        ('marker = "noisy"\nlevel = 2.5', [(4, 11), (12, 19), (20, 27), (28, 35), (36, 39)]),
        ('marker = "phase"\nwhen = "changes"', [(0, 9), (10, 19), (20, 29), (30, 39)]),
        ('marker = "phase"\nwhile = "cut"', [(10, 19), (30, 39)]),
        ('marker = "cycle"\nwhen = "changes"', [(0, 7), (8, 15), (16, 23), (24, 31), (32, 39)]),
        ('marker = "cycle"\nwhile = 3', [(16, 23)]),
        ('from = "5 s"\nmarker = "cycle"\nwhen = "changes"', [(20, 23), (24, 31), (32, 39)]),
    ],
)
def test_a_log_is_cut_into_repeats(tmp_path: Path, log: Path, cut: str, expected: list[tuple[int, int]]) -> None:
    assert pieces(tmp_path, cut, log) == expected


def test_repeats_on_a_grid_begin_at_their_marker(tmp_path: Path, log: Path) -> None:
    run = bring(tmp_path, '[cut]\nat = ["1.1 s", "5 s"]\n' + HEAD.replace('"s"', '"s"\nstep = "100 ms"', 1), log, "run/repeat_1")
    np.testing.assert_allclose(run.t, 0.1 * np.arange(39), rtol=0.0, atol=ROUNDOFF)
    np.testing.assert_allclose(run["a.x"], (1.1 + run.t) / H, rtol=10.0 * ROUNDOFF)


def test_dates_are_clocks_and_instants(tmp_path: Path) -> None:
    rows = [f"03.05.2024 23:59:{k},500;{k}" for k in range(50, 60)]
    (tmp_path / "log.csv").write_text("t;x\n" + "\n".join(rows) + "\n", encoding="utf-8")
    head = '[log]\ndelimiter = ";"\n' + HEAD.replace('unit = "s"', 'format = "%d.%m.%Y %H:%M:%S,%f"', 1)
    run = bring(tmp_path, "[cut]\nfrom = 2024-05-04T01:59:53.5+02:00\n" + head, tmp_path / "log.csv")
    assert (run.t[0], run["a.x"][0]) == (3.0, 53.0)
    assert run.info["imported"]["date"] == "2024-05-03T23:59:53.500000+00:00"
    again = bring(tmp_path, '[cut]\nat = ["2024-05-03T23:59:52.5", "8 s"]\n' + head, tmp_path / "log.csv", "run/repeat_2")
    assert again["a.x"].tolist() == [58.0, 59.0]
    (tmp_path / "x").mkdir()
    assert "'03.05.2024 23:59:50,500' is no date and time of the format 'iso'" in refused(
        tmp_path / "x", head.replace("%d.%m.%Y %H:%M:%S,%f", "iso"), tmp_path / "log.csv"
    )


@pytest.mark.parametrize(
    ("cut", "expected"),
    [
        ('from = "20 s"', "map.toml:1: [cut]: nothing is in the window 20 s to ...; the log covers 0 s to 10 s"),
        ('from = "4 s"\nto = "3 s"', "nothing is in the window 4 s to 3 s"),
        ("from = 4", 'map.toml:2: [cut] from: 4 has no unit; expected a text with one, such as "4 s"'),
        ('from = "2024-05-03 10:61"', "expected a date and time such as 2024-05-03T10:15:00Z; found '2024-05-03 10:61'"),
        ("from = 2024-05-03T10:15:00", "2024-05-03T10:15:00 is a date, and the log says none; give the time of the run, such as '2.5 s'"),
        ('period = "11 s"', "the period of 11 s is longer than the 10 s that there are"),
        ('period = "0 s"', "map.toml:2: [cut] period: expected a positive time; found '0 s'"),
        ('period = "250 ms"', "piece 1 of 40, 0 s to 0.25 s, has 1 rows; expected at least 2"),
        ('at = ["3 s", "1 s"]', "at: the times must increase; found 3 s, 1 s"),
        ('at = ["3 s", "10 s"]', "at: 10 s is outside of the time that is imported, 0 s to 10 s"),
        ('at = ["1 s"]\nperiod = "2 s"', "period and at both cut the log; give one of period, at and marker"),
        ('at = ["1 s", "5 s"]\nlength = "6 s"', "no piece is as long as the length of 6 s; the longest has 5 s"),
        ('length = "6 s"', "map.toml:2: [cut] length: is that of the pieces; give period, at or marker, or to"),
        ('when = "rises"', "map.toml:2: [cut] when: belongs to a marker; give marker, the column that it is about"),
        ('marker = "triger"', "unknown column 'triger'; did you mean 'trigger'"),
        ('marker = "trigger"\nwhen = "jumps"', "unknown when 'jumps'; available: rises, falls, changes"),
        ('marker = "trigger"\nwhile = 2', "map.toml:1: [cut]: the marker 'trigger' never is 2.0; its values: 0, 1"),
        ('marker = "phase"', "the marker 'phase' holds texts, which do not rise or fall"),
        ('marker = "phase"\nwhile = "cutting"', "the marker 'phase' never is 'cutting'; its values: 'back', 'cut', 'start'"),
        ('marker = "noisy"\nlevel = 7', "the marker 'noisy' never rises through 7 in the time that is imported; its values: 0.1, "),
        ('marker = "x"\nwhen = "falls"', "the marker 'x' never falls in the time that is imported; its values lie between 0 and 39"),
        ('marker = "cycle"\nwhile = 1\nwhen = "rises"', "gives the pieces alone; leave out when and level"),
        ("repeats = 3", "[cut] repeats: unknown key 'repeats'"),
    ],
)
def test_what_cuts_nothing_is_refused(tmp_path: Path, log: Path, cut: str, expected: str) -> None:
    assert expected in refused(tmp_path, f"[cut]\n{cut}\n{HEAD}", log)


def test_repeats_are_not_overwritten_unasked_and_those_of_an_earlier_import_go(tmp_path: Path, log: Path) -> None:
    assert len(pieces(tmp_path, 'period = "2 s"', log)) == 5
    mapping = tmp_path / "map.toml"
    mapping.write_text(mapping.read_text(encoding="utf-8").replace("2 s", "3 s"), encoding="utf-8")
    with pytest.raises(ResultsError, match="repeat_1 already holds a run"):
        import_log(mapping, log, tmp_path / "run")
    assert len(import_log(mapping, log, tmp_path / "run", overwrite=True)[0]) == 3
    assert sorted(f.name for f in (tmp_path / "run").iterdir()) == ["repeat_1", "repeat_2", "repeat_3"]


def test_the_command_counts_repeats_on_and_says_what_it_left_out(tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "map.toml").write_text('[cut]\nperiod = "3 s"\n' + HEAD, encoding="utf-8")
    arguments = ["import", str(tmp_path / "map.toml"), str(log), "--out", str(tmp_path / "run"), "--label", "repeat=4"]
    assert cli.main(arguments) == 0
    out = capsys.readouterr().out
    assert f"{tmp_path / 'run' / 'repeat_6'}: 12 rows, 250 ms apart, 1 columns of a.x" in out
    assert "left out: the last 1 s, which are no whole period" in out
    assert cli.main([*arguments, "--overwrite", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [r["span_s"] for r in told["runs"]] == [[0.0, 3.0], [3.0, 6.0], [6.0, 9.0]]
    assert told["left_out"] == "the last 1 s, which are no whole period"
    assert Run.load(tmp_path / "run" / "repeat_5").info["labels"]["repeat"] == 5
    assert cli.main([*arguments[:-1], "repeat=first", "--overwrite"]) == 2
    assert "repeat: expected a whole number, from which the repeats count; found 'first'" in capsys.readouterr().err
