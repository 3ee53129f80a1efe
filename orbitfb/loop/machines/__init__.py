"""Machines with a restriction: some BPMs masked, or writing forbidden."""
