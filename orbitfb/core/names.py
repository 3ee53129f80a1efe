"""Names of PVs that no table holds: the slow channels of the machine that the loop watches."""

CURRENT_PV = "SR:C03-BI{DCCT:1}I:Real-I"
"""Stored current [mA]."""

RF_PV = "RF{Osc:1}Freq:SP"
"""Setpoint of the RF frequency [Hz]."""

RF_READBACK_PV = "RF{Osc:1}Freq:I"
"""Readback of the RF frequency [Hz]."""
LEASE_PV = "SR:FB{Lease:%}Owner-SP"
"""Who writes to a plane of the machine; % stands for the plane, X or Y."""

RF_FREQUENCY, RF_READBACK, RF_STEP = "rf_frequency", "rf_readback", "rf_step"
"""Slow channels of the RF: its setpoint and its readback, and by how much the loop changed it since
the orbit before [Hz]."""
