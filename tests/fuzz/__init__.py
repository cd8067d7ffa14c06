"""Fuzzing of readers: randomly changed files must give a result or one of our errors."""
