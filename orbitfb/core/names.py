"""Names of PVs that no table holds: the two slow channels of the machine that the loop watches."""

CURRENT_PV = "SR:C03-BI{DCCT:1}I:Real-I"
"""Stored current [mA]."""

RF_PV = "RF{Osc:1}Freq:SP"
"""RF frequency [Hz]."""
LEASE_PV = "SR:FB{Lease:%}Owner-SP"
"""Who writes to a plane of the machine; % stands for the plane, X or Y."""
