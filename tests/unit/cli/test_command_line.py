"""What the command line sets up before anything is imported."""

import os
import subprocess
import sys


def test_linear_algebra_has_one_thread_from_the_start():
    """Numpy reads the number when it is imported: it must be set before."""
    asked = (
        "import sys, os, orbitfb.cli\n"
        "print('numpy' in sys.modules, os.environ['OPENBLAS_NUM_THREADS'])"
    )
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    told = subprocess.run(
        [sys.executable, "-c", asked], env=environment, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == ["False", "1"]
