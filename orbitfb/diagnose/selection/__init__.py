"""Which hypotheses are accepted: those that lead, weighed over floors of their own, one by one."""
