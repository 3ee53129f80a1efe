"""The machine of an open loop lent to a procedure in another thread, such as a measurement."""
