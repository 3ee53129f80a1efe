"""Environment variables of Channel Access, for the soft IOC and for its clients."""


def client_environment(port: int) -> dict[str, str]:
    """Give what a client needs to find the soft IOC on this computer, and nothing else.

    Args:
        port: The port that it announced.
    """
    return {
        "EPICS_CA_ADDR_LIST": "127.0.0.1",
        "EPICS_CA_AUTO_ADDR_LIST": "NO",
        "EPICS_CA_SERVER_PORT": str(port),
        # not production's repeater on 5065, which would pass on production's beacons
        "EPICS_CA_REPEATER_PORT": str(port + 1 if port < 65535 else port - 1),
    }


def server_environment(plain: bool) -> dict[str, str]:
    """Give what caproto reads when it is imported in the soft IOC.

    Args:
        plain: Leave caproto's own delays as they are.
    """
    loopback = {
        "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
        "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
        # an empty list would mean broadcasts
        "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
        "EPICS_CAS_BEACON_PORT": "15065",
    }
    # for what it serves itself caproto holds updates back for 10 ms in the hope of more, and
    # queues 10000 of them for a client that does not read
    sooner = {
        "CAPROTO_SERVER_HIGH_LOAD_TIMEOUT_SEC": "0.001",
        "CAPROTO_MAX_TOTAL_SUBSCRIPTION_BACKLOG": "2000",
    }
    return loopback if plain else loopback | sooner
