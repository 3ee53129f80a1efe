"""Measurement of the response matrix: sequence, watch, regression, state, file. No EPICS here."""
