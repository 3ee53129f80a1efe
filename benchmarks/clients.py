"""Run a client in a process of its own and get its figures."""

import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from typing import Any, Literal

from benchmarks.servers import Running, Server, job_of, serving
from orbitfb.sim.job import SimJob

Client = Literal["ours", "service", "plain", "lean"]


@dataclass(frozen=True, slots=True)
class Run:
    """One server, one client, some seconds.

    Args:
        server: Which server.
        client: `ours`: the loop alone; `service`: with every subscriber of the service, archive
            and learner; `plain`: PV.callback and PV.put; `lean`: the same, but told not to monitor
            its correctors, which pyepics does by default.
        rate_hz: Of the ring; None: lockstep.
        seconds: Measured, after the warm-up.
        warmup: Not measured, once the loop is closed [s].
        size: Of a counting ring; None: the default ring, 180 BPMs and 180 correctors.
        disturb: What goes on beside the loop: nothing, policy swaps, or refits.
        seed: Of the ring.
    """

    server: Server
    client: Client
    rate_hz: float | None
    seconds: float
    warmup: float = 1.0
    size: int | None = None
    disturb: Literal["nothing", "swaps", "refits"] = "nothing"
    seed: int = 1


@dataclass(frozen=True, slots=True)
class ClientJob:
    """What a client process is told."""

    run: Run
    port: int
    pva_port: int
    server_pid: int
    sim: SimJob

    @property
    def period(self) -> float | None:
        """Of the ring [s]; None: lockstep."""
        return None if self.run.rate_hz is None else 1.0 / self.run.rate_hz

    def dump(self) -> str:
        """Write it as one line."""
        fields = {name: getattr(self, name) for name in ("port", "pva_port", "server_pid")}
        return json.dumps(
            {**fields, "run": asdict(self.run), "sim": self.sim.model_dump(mode="json")}
        )

    @classmethod
    def load(cls, text: str) -> "ClientJob":
        """Read what `dump` wrote."""
        fields = json.loads(text)
        return cls(
            Run(**fields["run"]),
            fields["port"],
            fields["pva_port"],
            fields["server_pid"],
            SimJob.model_validate(fields["sim"]),
        )


def measure(run: Run) -> dict[str, Any]:
    """Start the server and the client of a run and return what the client measured."""
    job = job_of(run.server, run.rate_hz, run.seed)
    with serving(run.server, job, run.size) as server:
        return {**asdict(run), **_ask_client(_job(run, server, job), server)}


def _job(run: Run, server: Running, job: SimJob) -> ClientJob:
    return ClientJob(run, server.port, server.pva_port, server.pid, job)


def _ask_client(job: ClientJob, server: Running) -> dict[str, Any]:
    module = "plain_client" if job.run.client in ("plain", "lean") else "our_client"
    environment = {
        "EPICS_CA_ADDR_LIST": "127.0.0.1",
        "EPICS_CA_AUTO_ADDR_LIST": "NO",
        "EPICS_CA_SERVER_PORT": str(server.port),
        "EPICS_CA_REPEATER_PORT": str(server.port + 1 if server.port < 65535 else 65534),
        "OPENBLAS_NUM_THREADS": "1",
    }
    limit = 60.0 + 2.0 * job.run.seconds
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{module}"],
        input=job.dump().encode(),
        capture_output=True,
        env=os.environ | environment,
        timeout=limit,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{job.run}: {done.stderr.decode()}")
    return json.loads(done.stdout.splitlines()[-1])
