"""How setpoints are changed by hand."""

from pydantic import Field

from orbitfb.core.settings import Settings


class CorrectionSettings(Settings):
    """One correction of an open loop by hand, and its undoing."""

    step: float = Field(
        default=0.5,
        gt=0,
        description="Largest change of a setpoint in one tick [A]; limits.change_per_tick also "
        "holds.",
    )
    preview_age: float = Field(
        default=60.0,
        gt=0,
        description="How long a correction that was computed may be applied [s].",
    )
    undo_depth: int = Field(
        default=20, ge=1, le=1000, description="Corrections that can be undone, newest first."
    )


USUAL = CorrectionSettings()
"""What holds where nothing else is said."""
