"""A process that has used libca ends by itself, wherever it was told to search."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system


@pytest.mark.parametrize("name_servers", ["", "127.0.0.1:9"])
def test_a_process_ends_whatever_name_servers_it_has(name_servers: str):
    """libca waits for ever for an unused context to end where it has a name server."""
    code = """
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context
context = Context()
ChannelGroup(context, ["NO:SUCH:PV"]).open()
context.destroy()
print("the end")
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"EPICS_CA_NAME_SERVERS": name_servers},
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    )
    assert done.stdout == "the end\n"
