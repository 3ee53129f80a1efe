"""PVs over pvAccess: p4p, the extra `pva`, behind the same groups of channels."""
