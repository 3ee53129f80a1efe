"""The machine over EPICS Channel Access: the only package that imports pyepics."""
