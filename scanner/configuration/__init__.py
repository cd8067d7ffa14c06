"""Configuration files: their schema, and changes to them that keep comments."""

from scanner.configuration.edit import set_keys
from scanner.configuration.schema import (
    CONFIGURATION_KEY,
    CharucoSettings,
    Config,
    ScaleSettings,
    load_config,
    recorded_config,
)
