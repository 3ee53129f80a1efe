"""Adaptive orbit feedback for synchrotron light sources on an EPICS control network."""

__version__ = "0.1.0"
