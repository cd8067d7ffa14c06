"""Configuration files: their schema, and changes to them that keep comments."""

from scanner.configuration.cloud_steps import MOST_STEPS, CloudSettings, CloudStep
from scanner.configuration.edit import check_text, example, set_keys, with_key, write_text
from scanner.configuration.schema import CONFIGURATION_KEY, Config, load_config, recorded_config
from scanner.configuration.sections import CharucoSettings, ScaleSettings
