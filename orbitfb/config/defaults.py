"""What a short command must know of the configuration without building its tree."""

DATA_DIRECTORY = "orbitfb-data"
"""Where policies, archive and log are kept, below the working directory."""
ENVIRONMENT_PREFIX = "ORBITFB_"
"""What the variables of the configuration begin with."""
