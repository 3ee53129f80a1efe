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


def test_a_question_to_the_service_waits_for_no_import_of_arithmetic():
    """`orbitfb command status` asks; where nothing is configured it builds no configuration."""
    asked = (
        "import sys\n"
        "from orbitfb.cli.app import main\n"
        "sys.argv = ['orbitfb', 'command', 'status', '--data', 'nowhere']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "slow = {'numpy', 'orbitfb.config.tree', 'scipy', 'h5py', 'torch', 'structlog', 'rich'}\n"
        "print(sorted(slow & set(sys.modules)))"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("ORBITFB_")}
    told = subprocess.run(
        [sys.executable, "-c", asked], capture_output=True, text=True, check=True, env=environment
    )
    assert "no service of this user runs on" in told.stderr
    assert told.stdout.strip() == "[]"


def test_settings_wait_for_no_import_of_arithmetic():
    """What reads the configuration, as a command with `--config` does."""
    asked = (
        "import sys, orbitfb.config.load\n"
        "slow = {'scipy', 'h5py', 'torch', 'structlog', 'prometheus_client', 'epics', 'caproto'}\n"
        "print(sorted(slow & set(sys.modules)))"
    )
    told = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_the_loop_leaves_the_arithmetic_of_the_learner_to_the_trainer():
    """Half a second of every start."""
    asked = (
        "import sys, orbitfb.app.service.run\n"
        "slow = {'scipy', 'torch', 'orbitfb.models.identify'}\n"
        "print(sorted(slow & set(sys.modules)))"
    )
    told = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"
