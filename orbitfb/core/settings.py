"""The base of every part's configuration model."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """A frozen configuration node that refuses unknown keys and non-finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )
