"""Shell completion of bash: what a user gets who presses the tab key in a real shell."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
PROGRAM = Path(sys.executable).parent / "orbitfb"

SHELL = r"""
set -eu
export PATH={directory}:$PATH
source <(_ORBITFB_COMPLETE=source_bash orbitfb)
complete -p orbitfb >&2
while IFS= read -r line; do
    read -ra COMP_WORDS <<< "$line"
    [[ $line == *" " ]] && COMP_WORDS+=("")
    COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))
    COMPREPLY=()
    _orbitfb_completion orbitfb
    echo "${{COMPREPLY[*]}}"
done
"""


def test_bash_completes_commands_and_options():
    if not PROGRAM.exists():
        pytest.skip("the program is not installed beside Python")
    lines = [
        "orbitfb doc",
        "orbitfb import ",
        "orbitfb export response --o",
        "orbitfb policies act",
    ]
    done = subprocess.run(
        ["bash", "-c", SHELL.format(directory=PROGRAM.parent)],
        input="\n".join(lines) + "\n",
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"HOME": "/nonexistent"},
    )
    assert done.returncode == 0, done.stderr
    assert "-F _orbitfb_completion orbitfb" in done.stderr
    found = [line.split() for line in done.stdout.split("\n")[: len(lines)]]
    assert found[0] == ["doctor"]
    assert found[1] == ["response", "history", "lattice"]
    assert found[2] == ["--out"]
    assert found[3] == ["activate"]
