"""How to reach the machine over Channel Access, and over pvAccess where PVs are named so."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from orbitfb.core.names import CURRENT_PV, RF_PV
from orbitfb.core.settings import Settings
from orbitfb.epics.units import LengthUnit

MILLIAMPERE = 1e-3
LOWEST_PORT = 5001
"""libca takes 5064 instead of a lower port, and says so on stderr alone."""


def _separated_by_blanks(addresses: str) -> str:
    """Refuse what libca takes for one malformed address, and says so on stderr alone."""
    for sign in (",", ";"):
        if sign in addresses:
            raise ValueError(f"separate addresses by blanks, not by {sign!r}")
    return addresses


AddressList = Annotated[str, AfterValidator(_separated_by_blanks)]


PVA_SEARCH_PORT = 5076
"""UDP port to which every client of pvAccess searches unless told otherwise."""


class PvaSettings(Settings):
    """Where PVs named `pva://…` are searched for; what `epics` says holds for them, too."""

    address_list: AddressList = Field(
        default="",
        description="Addresses to search, separated by blanks (EPICS_PVA_ADDR_LIST); empty: the "
        "hosts of `epics.address_list`.",
    )
    name_servers: AddressList = Field(
        default="",
        description="Servers to ask over TCP, separated by blanks (EPICS_PVA_NAME_SERVERS).",
    )
    port: int = Field(
        default=PVA_SEARCH_PORT,
        gt=0,
        lt=65536,
        description="UDP port to which searches go (EPICS_PVA_BROADCAST_PORT).",
    )


class AuxiliarySettings(Settings):
    """A slow channel that is read beside the orbit."""

    pv: str = Field(min_length=1, description="Name of the PV.")
    scale: float = Field(default=1.0, description="SI value = scale × value of the PV.")
    stale_after: float | None = Field(
        default=None,
        gt=0,
        description="Age by its stamp beyond which the value is not known any more [s]; left "
        "out or false: never, as for a PV that is posted only when it changes or has no stamp.",
    )


def _default_auxiliary() -> dict[str, AuxiliarySettings]:
    return {
        "current": AuxiliarySettings(pv=CURRENT_PV, scale=MILLIAMPERE, stale_after=10.0),
        "rf_frequency": AuxiliarySettings(pv=RF_PV),
    }


class EpicsSettings(Settings):
    """Network, time limits and slow channels of the machine behind Channel Access."""

    address_list: AddressList = Field(
        default="127.0.0.1",
        description="Where to search for PVs: addresses separated by blanks (EPICS_CA_ADDR_LIST).",
    )
    name_servers: AddressList = Field(
        default="",
        description="Name servers or gateways to ask over TCP, separated by blanks "
        "(EPICS_CA_NAME_SERVERS).",
    )
    auto_address_list: bool = Field(
        default=False,
        description="Search on every network interface too (EPICS_CA_AUTO_ADDR_LIST).",
    )
    server_port: int = Field(
        default=5064,
        ge=LOWEST_PORT,
        lt=65536,
        description="Port on which the machine's IOCs listen (EPICS_CA_SERVER_PORT).",
    )
    connect_timeout: float = Field(
        default=5.0, gt=0, description="How long to wait for all PVs at start [s]."
    )
    answer_timeout: float = Field(
        default=1.0, gt=0, description="How long to wait for the answers to one request [s]."
    )
    bpm_unit: LengthUnit | Literal["egu"] = Field(
        default="mm",
        description="Unit of the BPM PVs of which the places table (column unit) says none; egu: "
        "what each of them states. PVs that state another one (EGU) are refused.",
    )
    setpoint_step: float = Field(
        default=0.0,
        ge=0,
        description="Step that the setpoint records hold [A], where they round what is put; 0: "
        "any value. Records of whole numbers (longout) have 1 A at least.",
    )
    stamp_window: float = Field(
        default=0.0,
        ge=0,
        description="How far the stamps of one orbit may lie apart [s], below half a period; 0: "
        "they must be equal.",
    )
    stuck_bpms: int = Field(
        default=9,
        ge=0,
        description="BPMs that may keep their old stamp while the others send a tick, or carry "
        "another one: they are left out until their stamp is that of the others; masked and "
        "disabled ones besides; 0: such an orbit is refused.",
    )
    stale_after: float = Field(
        default=1.0,
        gt=0,
        description="Age, by stamp against the wall clock, beyond which an orbit is refused [s].",
    )
    silent_after: float = Field(
        default=2.0,
        gt=0,
        description="Writes are refused when no complete orbit has come for so long [s]; it "
        "must exceed the period, and is three periods at least if left out.",
    )
    readback_wait: float = Field(
        default=0.01,
        ge=0,
        description="How long an orbit may wait for the readbacks of its own stamp [s]; they "
        "come within 1 ms unless the computer is overloaded.",
    )
    reconnect_period: float = Field(
        default=2.0, gt=0, description="Time between two searches for channels that are away [s]."
    )
    circuit_timeout: float = Field(
        default=5.0,
        ge=0.1,
        description="Silence after which a circuit is suspected dead [s] (EPICS_CA_CONN_TMO).",
    )
    pva: PvaSettings = Field(
        default=PvaSettings(), description="Where PVs named `pva://…` are searched for."
    )
    auxiliary: dict[str, AuxiliarySettings] = Field(
        default_factory=_default_auxiliary, description="Slow channels by name."
    )

    @property
    def searched(self) -> str:
        """Where PVs are searched for: addresses and name servers, separated by blanks."""
        return " ".join(filter(None, (self.address_list, self.name_servers)))

    @property
    def pva_addresses(self) -> str:
        """Addresses that are searched for PVs over pvAccess, separated by blanks."""
        hosts = (word.partition(":")[0] for word in self.address_list.split())
        return self.pva.address_list or " ".join(hosts)
