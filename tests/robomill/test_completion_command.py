"""`robomill completion` and `robomill --version`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

import robomill
from robomill.cli import COMMANDS, main
from robomill.command_options import SHELLS
from robomill.completion_command import script

CHECKS = {"bash": ["bash", "-n"], "zsh": ["zsh", "-n"], "fish": ["fish", "--no-execute"]}
"""Commands that read a script and run none of it."""


@pytest.fixture(scope="module")
def scripts() -> dict[str, str]:
    return {shell: script(shell) for shell in SHELLS}


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_and_example_is_completed(shell: str, scripts: dict[str, str]) -> None:
    wanted = (*(c.name for c in COMMANDS), "groove", "servo_axis", "checkpoint-every", "stiffness")
    assert not (lacking := [name for name in wanted if name not in scripts[shell]]), lacking


@pytest.mark.parametrize("shell", CHECKS)
def test_the_shell_can_read_it(shell: str, scripts: dict[str, str], tmp_path: Path) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    (tmp_path / "script").write_text(scripts[shell])
    subprocess.run([*CHECKS[shell], str(tmp_path / "script")], check=True)


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_a_command(scripts: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "script").write_text(scripts["bash"])
    ask = f"source {tmp_path}/script; COMP_WORDS=(robomill dia); COMP_CWORD=1; _shtab_robomill; echo ${{COMPREPLY[@]}}"
    assert subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True).stdout.split() == ["diagnose"]


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out == f"robomill {robomill.__version__}\n"


def test_an_unknown_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["completion", "ksh"])
    assert "choose from bash, zsh, fish" in capsys.readouterr().err.replace("'", "")
