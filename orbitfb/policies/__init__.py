"""Policies: from an orbit error to a change of the setpoints."""
