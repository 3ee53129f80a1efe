"""The integrity screen: what is certain before any statistics, and free.

A false alarm is worse than a miss here: what is missed is still there for the tournament, what
is said here is believed. So only exact repetitions, exact sums and overwhelming ratios count.
"""

from orbitfb.diagnose.screen.channels import check_channels
from orbitfb.diagnose.screen.deaf import check_deaf
from orbitfb.diagnose.screen.model import check_model, check_units
from orbitfb.diagnose.screen.rails import RAIL, check_rails
from orbitfb.diagnose.screen.readback import check_readback
from orbitfb.diagnose.screen.repeats import check_repeats
from orbitfb.diagnose.screen.writes import check_clock, check_writes
from orbitfb.records.finding import Finding
from orbitfb.records.record import Record


def screen(record: Record) -> list[Finding]:
    """Look for repeated and clipped readings, lost writes, wrong units, mixed-up channels.

    Args:
        record: The record.

    Returns:
        Findings, the gravest first. With a `failure` among them a diagnosis would be nonsense.
    """
    rails = check_rails(record)
    clipped = {device for finding in rails for device in finding.devices}
    # A BPM that stands at its rail for long has been told.
    repeats = [f for f in check_repeats(record) if f.check != RAIL or f.devices[0] not in clipped]
    still = {device for finding in repeats if finding.effect for device in finding.devices}
    found = [
        *rails,
        *repeats,
        *(f for f in check_deaf(record) if f.devices[0] not in still | clipped),
        *check_clock(record),
        *check_writes(record),
        *check_readback(record),
    ]
    wrong = [*check_units(record), *check_model(record)]
    found += wrong
    if not any(finding.severity == "failure" for finding in found):
        found += check_channels(record)
    order = {"failure": 0, "warning": 1, "note": 2}
    return sorted(found, key=lambda finding: order[finding.severity])


def is_hopeless(findings: list[Finding]) -> bool:
    """Tell whether a diagnosis would be nonsense."""
    return any(finding.severity == "failure" for finding in findings)
