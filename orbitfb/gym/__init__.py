"""The simulated ring as an environment of gymnasium, and agents trained on it as policies."""
