"""The soft IOC as a child process: one line of JSON in, READY out, until the parent is gone."""

import sys

from pydantic import ValidationError

from orbitfb.core.errors import ConfigError, OrbitFeedbackError, OwnershipError
from orbitfb.sim.job import PORT_TAKEN, SimJob
from orbitfb.sim.process import run_job
from orbitfb.sim.served import Served


def main() -> int:
    """Serve the job on standard input until it ends, or until SIGTERM or SIGINT.

    Returns:
        2 if the job cannot be done, 3 if somebody else has the port; the reason is on standard
        error. After a clean stop the process ends with 0.
    """
    try:
        run_job(_read_job(), _announce, sys.stdin.fileno())
    except OrbitFeedbackError as error:
        sys.stderr.write(f"{error}\n")
        return PORT_TAKEN if isinstance(error, OwnershipError) else 2
    return 0


def _read_job() -> SimJob:
    try:
        return SimJob.model_validate_json(sys.stdin.buffer.readline())
    except ValidationError as error:
        raise ConfigError(f"the job on standard input is wrong: {error}") from error


def _announce(served: Served) -> None:
    pva = f" pva={served.pva_port}" if served.pva_port else ""
    sys.stdout.write(f"READY port={served.port} pvs={served.pvs}{pva}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
